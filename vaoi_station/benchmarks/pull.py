"""How strongly whole pixels pull at a link: the bias of matches over the fraction of a pixel that a picture moved.

On a conveyor the fraction is the same all over an image, so this bias does not average out over the links of a pair of
frames, and a chain of rows adds it up (S-curve, as digital image correlation calls it). Pictures are sums of sinusoids,
rendered exactly at any shift, rounded to whole grey levels, with noise; OpenCV's plain Lucas-Kanade is measured too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.benchmarks.s_curve import Panel, draw
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.patches import match_patches, patch_centres

_SIDE_PX, _STEP_PX, _BORDER_PX = 420, 26, 40
_FINEST_PX, _COARSEST_PX, _WAVES = 4.5, 60.0, 120
_CONTRAST = 30.0
_WHOLE_PX = (3.0, -2.0)
FRACTIONS = tuple(round(-0.5 + 0.05 * n, 2) for n in range(21))


@dataclass(frozen=True)
class Pull:
    """Mean errors of many patches along the motion, px, by fraction."""

    axis: str
    noise: float
    """Standard deviation, grey levels."""
    fraction: tuple[float, ...]
    error_px: tuple[float, ...]
    lucas_kanade_px: tuple[float, ...]
    patches: int

    @property
    def largest_px(self) -> float:
        """The worst bias at any fraction."""
        return max(abs(e) for e in self.error_px)


@dataclass(frozen=True)
class PullFigures:
    """Everything `vaoi bench --links` finds."""

    pulls: tuple[Pull, ...]

    def document(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)

    def plot(self) -> str:
        """The curves as SVG."""
        panels = [Panel(f"{p.axis}, noise {p.noise:g}", p.fraction, p.error_px, p.lucas_kanade_px) for p in self.pulls]
        head = "mean error of links along the motion, px, over the fraction of a pixel"
        return draw(panels, head, ("ours", "Lucas-Kanade"))

    def lines(self) -> Iterator[str]:
        """One line per axis and noise."""
        for p in self.pulls:
            theirs = max(abs(e) for e in p.lucas_kanade_px)
            yield (
                f"along {p.axis}, noise {p.noise:g}: bias ≤ {p.largest_px:.4f} px at every fraction "
                f"({p.patches} patches; plain Lucas-Kanade {theirs:.4f} px)"
            )


def measure_pull(noises: tuple[float, ...] = (0.0, 2.0), seed: int = 11) -> PullFigures:
    """Measure the bias along x and y, without and with noise."""
    return PullFigures(tuple(_pull(axis, noise, seed) for noise in noises for axis in ("x", "y")))


def _pull(axis: str, noise: float, seed: int) -> Pull:
    g = np.random.default_rng(seed)
    texture = _Texture(g)
    y, x = np.mgrid[_BORDER_PX : _SIDE_PX - _BORDER_PX : _STEP_PX, _BORDER_PX : _SIDE_PX - _BORDER_PX : _STEP_PX]
    places = np.stack([x.ravel(), y.ravel()], -1)
    a = _film(texture, (0.0, 0.0), noise, g)
    ours, theirs = [], []
    along = 0 if axis == "x" else 1
    for fraction in FRACTIONS:
        shift = np.array(_WHOLE_PX)
        shift[along] += fraction
        b = _film(texture, (float(shift[0]), float(shift[1])), noise, g)
        start = patch_centres(places) + np.round(shift)
        found = match_patches(a, b, places, start)
        ours.append(float((found.b_px - patch_centres(places) - shift)[found.found, along].mean()))
        theirs.append(float((_lucas_kanade(a, b, places, shift) - places - shift)[:, along].mean()))
    return Pull(axis, noise, FRACTIONS, tuple(ours), tuple(theirs), len(places))


def _lucas_kanade(a: NDArray[np.uint8], b: NDArray[np.uint8], places: NDArray[np.int_], shift: Floats) -> Floats:
    points = places.astype(np.float32).reshape(-1, 1, 2)
    start = (points + np.round(shift)).astype(np.float32)
    found, _, _ = cv2.calcOpticalFlowPyrLK(
        a, b, points, start, winSize=(21, 21), maxLevel=0, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    return np.asarray(found.reshape(-1, 2), dtype=np.float64)


def _film(texture: _Texture, shift: tuple[float, float], noise: float, g: np.random.Generator) -> NDArray[np.uint8]:
    grey = texture.seen(shift)
    return np.asarray(np.clip(np.round(grey + g.normal(0, noise, grey.shape)), 0, 255), dtype=np.uint8)


class _Texture:
    """Sinusoids of random direction about grey 128, none finer than a lens lets through."""

    def __init__(self, g: np.random.Generator) -> None:
        direction = g.uniform(0, 2 * math.pi, _WAVES)
        frequency = np.exp(g.uniform(math.log(1 / _COARSEST_PX), math.log(1 / _FINEST_PX), _WAVES))
        self._x, self._y = frequency * np.cos(direction), frequency * np.sin(direction)
        self._phase = g.uniform(0, 2 * math.pi, _WAVES)

    def seen(self, shift: tuple[float, float]) -> Floats:
        """(420, 420) grey levels with the texture's origin at pixel `shift`."""
        at = np.arange(_SIDE_PX)
        across = np.exp(2j * math.pi * self._x[:, None] * (at - shift[0]))
        down = np.exp(1j * (2 * math.pi * self._y[:, None] * (at - shift[1]) + self._phase[:, None]))
        return np.asarray(128 + _CONTRAST * math.sqrt(2 / _WAVES) * (down.T @ across).real)
