"""Compiled inner loops of merging: grey levels → radiance of a part of a frame, and sums weighted by noise.

The module is imported on first use, because Numba takes a moment to load.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.photometry.noise import Floats32

BLOCK_SHIFT = 6
"""Binary logarithm of the side of a block, px, over which the flat field counts as constant for the noise."""


@compiled
def linearise(
    pixels: NDArray[Any], dark: Floats32, flat: Floats32, numbers: tuple[float, float, float], out: Floats32
) -> None:
    """Write (grey − dark) / flat · scale to `out` (h, w); NaN where a pixel is saturated, or the flat field near zero.

    Args:
        pixels: (h, w), 8 or 16 bit.
        dark: grey level of darkness (h, w), or (1, 1) for all pixels.
        flat: flat field (h, w), or (1, 1) for all pixels.
        numbers: grey levels per pixel value, scale, and the pixel value from which on a pixel is saturated.
        out: result.
    """
    to_grey, scale, full = np.float32(numbers[0]), np.float32(numbers[1]), numbers[2]
    least, nothing = np.float32(0.02), np.float32(np.nan)
    h, w = pixels.shape
    dark_map, flat_map = dark.shape[0] > 1, flat.shape[0] > 1
    for y in range(h):
        for x in range(w):
            p = pixels[y, x]
            f = flat[y, x] if flat_map else flat[0, 0]
            d = dark[y, x] if dark_map else dark[0, 0]
            value = (np.float32(p) * to_grey - d) / f * scale
            out[y, x] = value if p < full and f > least else nothing


@compiled
def accumulate(
    value: Floats32, scales: NDArray[np.float64], noise: tuple[float, float], total: Floats32, weight: Floats32
) -> None:
    """Add one picture to the sums of a merge; NaN counts for nothing.

    Args:
        value: radiance (h, w).
        scales: grey levels per unit of radiance, for each block of the picture.
        noise: variance of a dark pixel, and variance per grey level of signal.
        total: sum (h, w) of value / variance, changed in place.
        weight: sum (h, w) of 1 / variance, changed in place.
    """
    h, w = value.shape
    for y in range(h):
        for x in range(w):
            v = value[y, x]
            s = np.float32(scales[y >> BLOCK_SHIFT, x >> BLOCK_SHIFT])
            # The weight depends so little on the pixel's own noise that dark noise gains no weight: the bias is
            # `noise[1]` grey levels, some hundredths of one.
            one = s * s / (np.float32(noise[0]) + np.float32(noise[1]) * max(v, np.float32(0)) * s)
            seen = v == v  # noqa: PLR0124  (NaN differs from itself)
            total[y, x] += one * v if seen else np.float32(0)
            weight[y, x] += one if seen else np.float32(0)
