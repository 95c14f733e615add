"""Select corners to match: in each cell of a grid the pixel with the most texture in both directions.

The measure of texture is the smaller eigenvalue of the structure tensor (Shi and Tomasi, 1994) over 3×3 pixels of a
reduced frame, with slopes by Sobel.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined

_REACH = 2
"""Pixels on each side that the structure tensor reads: one for its sum, one for the slopes."""
_UNIT = 1 / (4 * 3 * 255)
"""Scale of slopes, as OpenCV's cornerMinEigenVal has it: 4 for Sobel, 3 for the block size, 255 grey levels."""
_GOOD_SHARE, _WEAK, _LEAST = 0.9, 0.003, 1e-5
"""A corner is dropped as noise or bare belt if its texture is below `_WEAK` times the quantile `_GOOD_SHARE` of all
cells, or below `_LEAST`."""

_Plane = NDArray[np.float32]
_Ints = NDArray[np.int64]


@compiled
def best_corners(image: NDArray[np.uint8], x0: int, y0: int, across: tuple[int, int], down: tuple[int, int]) -> _Ints:
    """Return the best pixel (k, 2) of every cell that has a good one, x and y in the image.

    Args:
        image: (h, w) reduced.
        x0: first column of the first cell.
        y0: first line of it.
        across: number of cells in x, and their width.
        down: number of cells in y, and their height.
    """
    nx, width = across
    ny, height = down
    columns = nx * width
    score = np.zeros((ny * height, columns), np.float32)
    _corners(image, x0, y0, score)
    best, at = np.zeros(nx * ny, np.float32), np.zeros((nx * ny, 2), np.int64)
    for n in range(nx * ny):
        left, top = n % nx * width, n // nx * height
        best[n] = -1.0
        for y in range(top, top + height):
            for x in range(left, left + width):
                if score[y, x] > best[n]:
                    best[n], at[n, 0], at[n, 1] = score[y, x], x0 + x, y0 + y
    # the quantile of the cells' best is a measure of the good ones, even where most cells show bare belt
    least = max(_WEAK * np.sort(best)[int(len(best) * _GOOD_SHARE)], _LEAST)
    return np.asarray(at[best > least])


@inlined
def _corners(image: NDArray[np.uint8], x0: int, y0: int, score: _Plane) -> None:
    """Compute the smaller eigenvalue at the pixels from (x0, y0) on; 0 within `_REACH` of the image's border."""
    rows, columns = score.shape
    h, w = image.shape
    left, top = max(x0, _REACH), max(y0, _REACH)
    right, bottom = min(x0 + columns, w - _REACH), min(y0 + rows, h - _REACH)
    # slopes are needed one pixel further on every side, for the sums over 3×3
    wide, high = right - left + 2, bottom - top + 2
    if wide <= 2 or high <= 2:
        return
    gx, gy = np.empty(wide * high, np.float32), np.empty(wide * high, np.float32)
    unit = np.float32(_UNIT)
    for y in range(high):
        above, here, below = image[top - 2 + y], image[top - 1 + y], image[top + y]
        a, b, c = above[left - 2 : right + 2], here[left - 2 : right + 2], below[left - 2 : right + 2]
        to_x, to_y = gx[y * wide : (y + 1) * wide], gy[y * wide : (y + 1) * wide]
        for x in range(wide):
            before, after = a[x] + 2 * b[x] + c[x], a[x + 2] + 2 * b[x + 2] + c[x + 2]
            over, under = a[x] + 2 * a[x + 1] + a[x + 2], c[x] + 2 * c[x + 1] + c[x + 2]
            to_x[x], to_y[x] = unit * np.int32(after - before), unit * np.int32(under - over)
    size = wide * (high - 2)
    xx, xy, yy = np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32)
    for n in range(size):
        u0, u1, u2 = gx[n], gx[n + wide], gx[n + 2 * wide]
        v0, v1, v2 = gy[n], gy[n + wide], gy[n + 2 * wide]
        xx[n], xy[n], yy[n] = u0 * u0 + u1 * u1 + u2 * u2, u0 * v0 + u1 * v1 + u2 * v2, v0 * v0 + v1 * v1 + v2 * v2
    half = np.float32(0.5)
    for y in range(high - 2):
        f, g, k = xx[y * wide : (y + 1) * wide], xy[y * wide : (y + 1) * wide], yy[y * wide : (y + 1) * wide]
        to = score[top - y0 + y, left - x0 : right - x0]
        for x in range(wide - 2):
            p, q, r = f[x] + f[x + 1] + f[x + 2], g[x] + g[x + 1] + g[x + 2], k[x] + k[x + 1] + k[x + 2]
            to[x] = half * (p + r) - math.sqrt(half * half * (p - r) * (p - r) + q * q)
