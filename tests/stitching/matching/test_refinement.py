"""The compiled loop agrees with a few lines of numpy for one patch at a time."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.stitching.matching.frames import read_only
from vaoi_station.stitching.matching.refinement import (
    BINOMIAL,
    FRACTIONS,
    SINC,
    TAPS,
    WINDOW_PX,
    refine,
)


@pytest.mark.parametrize("period_px", [6.0, 10.0, 25.0])
def test_the_interpolation_shifts_waves_of_blurred_texture(period_px: float) -> None:
    at = np.arange(1 - TAPS // 2, TAPS // 2 + 1)
    fractions = np.linspace(0, 1, FRACTIONS + 1)
    exact = np.exp(2j * np.pi * fractions / period_px)
    found = SINC @ np.exp(2j * np.pi * at / period_px)
    shift_px = np.angle(found / exact) * period_px / (2 * np.pi)
    assert np.abs(shift_px).max() < 0.0025


Array = NDArray[np.float64]
HALF = WINDOW_PX // 2


def blurred(image: NDArray[Any]) -> Array:
    line = np.array([*BINOMIAL[:0:-1], *BINOMIAL]) / 64
    return np.asarray(cv2.sepFilter2D(image.astype(np.float64), -1, line, line))


def sharp(image: Array, x: float, y: float) -> Array:
    """The window whose first pixel lies at (x, y), by a sinc under a Kaiser window, six points each way."""

    def weights(f: float) -> Array:
        at = np.arange(-2, 4) - f
        w = np.sinc(at) * np.i0(6.0 * np.sqrt(np.maximum(1 - (at / 3) ** 2, 0)))
        return np.asarray(w / w.sum())

    x0, y0 = int(np.floor(x)), int(np.floor(y))
    cut = image[y0 - 2 : y0 + WINDOW_PX + 3, x0 - 2 : x0 + WINDOW_PX + 3]
    across = np.stack([np.convolve(row, weights(x - x0)[::-1], "valid") for row in cut])
    return np.stack([np.convolve(column, weights(y - y0)[::-1], "valid") for column in across.T], 1)


def reference(a: Array, b: Array, place: NDArray[np.int_], at: Array) -> dict[str, Any]:
    """The step that remains at a point in b, and the figures of the patch there."""
    x, y = place - (HALF - 1)
    t = a[y : y + WINDOW_PX, x : x + WINDOW_PX]
    gy, gx = ((n / 2)[y : y + WINDOW_PX, x : x + WINDOW_PX] for n in (_difference(a, 0), _difference(a, 1)))
    v, u = np.mgrid[-1 : 1 : WINDOW_PX * 1j, -1 : 1 : WINDOW_PX * 1j]
    light = np.stack([np.ones_like(t), t, t * u, t * v]).reshape(4, -1).T
    g = np.stack([gx, gy]).reshape(2, -1).T
    g = g - light @ np.linalg.lstsq(light, g, rcond=None)[0]
    hessian = g.T @ g
    s = sharp(b, at[0] - HALF + 0.5, at[1] - HALF + 0.5).ravel()
    tm = (t - t.mean()).ravel()
    gain = (s @ tm) / (tm @ tm)
    rest = s - light @ np.linalg.lstsq(light, s, rcond=None)[0]
    twice = np.stack(
        [blurred(np.pad(blurred(np.pad(c.reshape(t.shape), 20)), 0))[20:-20, 20:-20].ravel() for c in g.T], 1
    )
    left = float(rest @ rest) / gain**2
    return {
        "step": np.linalg.solve(hessian, g.T @ s) / gain,
        "hessian": hessian,
        "blurred": g.T @ twice,
        "scatter": np.sqrt(left / t.size),
        "score": np.sqrt((tm @ tm) / (tm @ tm + left)),
    }


def _difference(image: Array, axis: int) -> Array:
    return np.asarray(np.roll(image, -1, axis) - np.roll(image, 1, axis))


@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_a_match_is_where_the_step_of_numpy_is_zero(workshop: Any, noise: float) -> None:
    waves, g = workshop.waves(7), np.random.default_rng(1)
    lamp = 1 + 0.1 * np.linspace(-1, 1, 300)
    a = workshop.digitised(waves.levels(300, 240) + g.normal(0, noise, (240, 300)))
    b = workshop.digitised(0.8 * lamp * waves.levels(300, 240, (1.37, -0.61)) + g.normal(0, noise, (240, 300)))
    y, x = np.mgrid[40:200:40, 40:260:40]
    corners = np.stack([x.ravel(), y.ravel()], -1).astype(np.int64)
    guess = np.asarray(corners + (2.5, 0.5), dtype=np.float64)
    found = refine(read_only(a), read_only(b), corners, guess, 6.0)
    assert np.isfinite(found.last_step_px).all()
    assert not found.saturated.any()
    soft_a, soft_b = blurred(a), blurred(b)
    for n in range(len(corners)):
        true = reference(soft_a, soft_b, corners[n], found.b_px[n])
        hessian, twice = found.hessian[n], found.blurred[n]
        assert np.abs(true["step"]).max() < 1e-3
        assert hessian == pytest.approx(true["hessian"], rel=1e-3, abs=1e-4 * np.trace(hessian))
        assert twice == pytest.approx(true["blurred"], rel=0.02, abs=0.01 * np.trace(twice))
        assert found.scatter[n] == pytest.approx(true["scatter"], rel=0.02, abs=0.03)
        assert found.score[n] == pytest.approx(true["score"], abs=2e-4)


def test_saturation_is_reported_in_either_image(workshop: Any) -> None:
    a = workshop.waves(7).picture(120, 120)
    white = a.copy()
    white[56:60, 56:60] = 255
    corners, guess = np.array([[58, 58]]), np.array([[58.5, 58.5]])
    for one, other in ((a, white), (white, a)):
        assert refine(read_only(one), read_only(other), corners, guess, 6.0).saturated[0] == pytest.approx(
            16 / WINDOW_PX**2, abs=0.01
        )


_ONCE = """
import hashlib
import cv2
import numpy as np
from vaoi_station.stitching.matching.patches import match_patches, patch_centres

g = np.random.default_rng(1)
a = np.clip(cv2.GaussianBlur(g.normal(128, 300, (240, 300)), (0, 0), 2), 0, 255).astype(np.uint8)
b = cv2.GaussianBlur(np.roll(a, (1, 2), (0, 1)), (3, 3), 0.5)
places = g.integers(40, 190, (40, 2))
found = match_patches(a, b, places, patch_centres(places) + (1.7, 1.2))
print(hashlib.sha256(found.b_px.tobytes() + found.information.tobytes()).hexdigest())
"""


def test_fresh_and_cached_code_agree_to_the_last_digit(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    hashes = [
        subprocess.run(
            [sys.executable, "-c", _ONCE], env=environment, capture_output=True, text=True, check=True
        ).stdout
        for _ in range(2)
    ]
    assert len(hashes[0]) > 60
    assert hashes[0] == hashes[1]
