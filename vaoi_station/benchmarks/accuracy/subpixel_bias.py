"""Measure the bias of links towards whole pixels, over the fraction of a pixel by which an image moves.

On a conveyor, the fraction is the same everywhere in an image. Therefore the bias does not average out over the links
of two frames, and it adds up along a chain of rows. Digital image correlation calls its graph the S-curve. The images
are sums of sinusoids, which can be rendered exactly at any shift; noise is added and grey levels are rounded. OpenCV's
Lucas-Kanade method is measured for comparison with our refinement.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.benchmarks.accuracy.bias_plot import Panel, draw_bias_panels
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.patches import match_patches, patch_centres

_SIDE_PX, _STEP_PX, _BORDER_PX = 420, 26, 40
_FINEST_PX, _COARSEST_PX, _WAVES = 4.5, 60.0, 120
_CONTRAST = 30.0
_WHOLE_PX = (3.0, -2.0)
"""Whole-pixel part (x, y) of the shift between the two images; each fraction is added to it."""
FRACTIONS = tuple(round(-0.5 + 0.05 * n, 2) for n in range(21))


@dataclass(frozen=True)
class BiasCurve:
    """Mean error of many patches along the direction of motion, over the fraction of a pixel by which the image moves.

    Attributes:
        axis: direction of the motion, "x" or "y".
    """

    axis: str
    noise: float
    """Standard deviation of the noise, grey levels."""
    fraction: tuple[float, ...]
    error_px: tuple[float, ...]
    lucas_kanade_px: tuple[float, ...]
    patches: int

    @property
    def largest_px(self) -> float:
        """The largest bias over all sub-pixel fractions."""
        return max(abs(e) for e in self.error_px)


@dataclass(frozen=True)
class BiasFigures:
    """Figures of `vaoi bench --links`: the mean error of links over the sub-pixel part of the shift.

    There is one curve for each axis and each noise.
    """

    curves: tuple[BiasCurve, ...]

    def document(self) -> dict[str, Any]:
        """Return all figures of the benchmark as a dictionary for JSON."""
        # "pulls" is the key of the JSON file, which other programs may read.
        return {"pulls": [asdict(curve) for curve in self.curves]}

    def plot(self) -> str:
        """Draw the error over the sub-pixel position as SVG."""
        panels = [Panel(f"{p.axis}, noise {p.noise:g}", p.fraction, p.error_px, p.lucas_kanade_px) for p in self.curves]
        title = "mean error of links along the motion, px, over the fraction of a pixel"
        return draw_bias_panels(panels, title, ("ours", "Lucas-Kanade"))

    def lines(self) -> Iterator[str]:
        """Yield one line of text for each axis and each noise."""
        for p in self.curves:
            theirs = max(abs(e) for e in p.lucas_kanade_px)
            yield (
                f"along {p.axis}, noise {p.noise:g}: bias ≤ {p.largest_px:.4f} px at every fraction "
                f"({p.patches} patches; plain Lucas-Kanade {theirs:.4f} px)"
            )


def measure_subpixel_bias(noises: tuple[float, ...] = (0.0, 2.0), seed: int = 11) -> BiasFigures:
    """Measure the bias along x and y for each standard deviation of the noise, in grey levels."""
    return BiasFigures(tuple(_bias_curve(axis, noise, seed) for noise in noises for axis in ("x", "y")))


def _bias_curve(axis: str, noise: float, seed: int) -> BiasCurve:
    g = np.random.default_rng(seed)
    texture = Texture(g)
    y, x = np.mgrid[_BORDER_PX : _SIDE_PX - _BORDER_PX : _STEP_PX, _BORDER_PX : _SIDE_PX - _BORDER_PX : _STEP_PX]
    pixels = np.stack([x.ravel(), y.ravel()], -1)
    a = _image(texture, (0.0, 0.0), noise, g)
    ours, theirs = [], []
    along = 0 if axis == "x" else 1
    for fraction in FRACTIONS:
        shift = np.array(_WHOLE_PX)
        shift[along] += fraction
        b = _image(texture, (float(shift[0]), float(shift[1])), noise, g)
        # The refinement starts at the whole-pixel shift, as after the coarse search. So only the fraction is measured.
        start = patch_centres(pixels) + np.round(shift)
        found = match_patches(a, b, pixels, start)
        ours.append(float((found.b_px - patch_centres(pixels) - shift)[found.found, along].mean()))
        theirs.append(float((_lucas_kanade(a, b, pixels, shift) - pixels - shift)[:, along].mean()))
    return BiasCurve(axis, noise, FRACTIONS, tuple(ours), tuple(theirs), len(pixels))


def _lucas_kanade(a: NDArray[np.uint8], b: NDArray[np.uint8], pixels: NDArray[np.int_], shift: Floats) -> Floats:
    points = pixels.astype(np.float32).reshape(-1, 1, 2)
    start = (points + np.round(shift)).astype(np.float32)
    # Only one pyramid level, started at whole pixels, so that only the refinement is compared.
    found, _, _ = cv2.calcOpticalFlowPyrLK(
        a, b, points, start, winSize=(21, 21), maxLevel=0, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    return np.asarray(found.reshape(-1, 2), dtype=np.float64)


def _image(texture: Texture, shift: tuple[float, float], noise: float, g: np.random.Generator) -> NDArray[np.uint8]:
    grey = texture.render(shift)
    return np.asarray(np.clip(np.round(grey + g.normal(0, noise, grey.shape)), 0, 255), dtype=np.uint8)


class Texture:
    """Texture as a sum of sinusoids in random directions about grey 128. A lens still resolves the shortest wave."""

    def __init__(self, g: np.random.Generator) -> None:
        direction = g.uniform(0, 2 * math.pi, _WAVES)
        frequency = np.exp(g.uniform(math.log(1 / _COARSEST_PX), math.log(1 / _FINEST_PX), _WAVES))
        self._x, self._y = frequency * np.cos(direction), frequency * np.sin(direction)
        self._phase = g.uniform(0, 2 * math.pi, _WAVES)

    def render(self, shift: tuple[float, float]) -> Floats:
        """Render the texture as (420, 420) grey levels, with its origin at the pixel position `shift` (x, y)."""
        # Separable: a sum over waves of a row factor times a column factor, so one matrix product gives the image.
        at = np.arange(_SIDE_PX)
        across = np.exp(2j * math.pi * self._x[:, None] * (at - shift[0]))
        down = np.exp(1j * (2 * math.pi * self._y[:, None] * (at - shift[1]) + self._phase[:, None]))
        return np.asarray(128 + _CONTRAST * math.sqrt(2 / _WAVES) * (down.T @ across).real)
