"""Compiled inner loops of merging: grey levels → radiance of a part of a frame, and sums weighted by noise.

The module is imported on first use, because Numba takes a moment to load.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.photometry.noise import Floats32

BLOCK_SHIFT = 8
"""Binary logarithm of the side of a block, px, over which the flat field counts as constant for the noise.

A flat field changes by a few per cent over it, and so do weights and standard deviations; the radiance does not."""


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
    to_grey, scale, full = np.float32(numbers[0]), np.float32(numbers[1]), np.float32(numbers[2])
    least, nothing = np.float32(0.02), np.float32(np.nan)
    h, w = pixels.shape
    # One loop for each case: a test for every pixel would keep the compiler from using vector registers.
    if flat.shape[0] > 1 and dark.shape[0] == 1:
        level = dark[0, 0]
        for y in range(h):
            line, shade, result = pixels[y], flat[y], out[y]
            for x in range(w):
                p, f = np.float32(line[x]), shade[x]
                value = (p * to_grey - level) * scale / f
                value = value if p < full else nothing
                result[x] = value if f > least else nothing
        return
    for y in range(h):
        for x in range(w):
            p = np.float32(pixels[y, x])
            f = flat[y, x] if flat.shape[0] > 1 else flat[0, 0]
            d = dark[y, x] if dark.shape[0] > 1 else dark[0, 0]
            value = (p * to_grey - d) * scale / f
            value = value if p < full else nothing
            out[y, x] = value if f > least else nothing


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
    dark, shot, nothing = np.float32(noise[0]), np.float32(noise[1]), np.float32(0)
    for y in range(h):
        for block in range(scales.shape[1]):
            s = np.float32(scales[y >> BLOCK_SHIFT, block])
            # The loop over one block has no branch, so that the compiler uses vector registers.
            first, last = block << BLOCK_SHIFT, min((block + 1) << BLOCK_SHIFT, w)
            line, sums, weights = value[y, first:last], total[y, first:last], weight[y, first:last]
            for x in range(last - first):
                v = line[x]
                seen = v == v  # noqa: PLR0124  (NaN differs from itself)
                known = v if seen else nothing
                # The weight depends so little on the pixel's own noise that dark noise gains no weight: the bias is
                # `noise[1]` grey levels, some hundredths of one.
                one = s * s / (dark + shot * s * max(known, nothing))
                one = one if seen else nothing
                sums[x] += one * known
                weights[x] += one
