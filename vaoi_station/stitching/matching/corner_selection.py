"""Select the corners to match: in each cell of a grid, the pixel with the most texture in both directions.

The measure of texture is the smaller eigenvalue of the structure tensor (Shi and Tomasi, 1994). The tensor is summed
over 3×3 pixels of a reduced frame. The slopes in it come from the Sobel operator.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined

_REACH = 2
"""Number of pixels on each side that the texture of one pixel depends on: one for the sum over 3×3, one for Sobel."""
_UNIT = 1 / (4 * 3 * 255)
"""Scale of the slopes, the same as in OpenCV's cornerMinEigenVal: 4 for Sobel, 3 for the block size, 255 grey
levels."""
_GOOD_SHARE, _WEAK, _LEAST = 0.9, 0.003, 1e-5
"""A corner is dropped as noise or belt if its texture is below `_LEAST`, or below `_WEAK` times that of a good corner.

The texture of a good corner is the quantile `_GOOD_SHARE` of the best texture of each cell."""

_Plane = NDArray[np.float32]
_Ints = NDArray[np.int64]


def best_corners(image: NDArray[np.uint8], x0: int, y0: int, across: tuple[int, int], down: tuple[int, int]) -> _Ints:
    """Return the corners (k, 2), x and y in the image: the best pixel of each cell, without cells of weak texture.

    Args:
        image: (h, w) a reduced frame.
        x0: first pixel column of the grid.
        y0: first pixel line of the grid.
        across: number of cells in x, and the width of a cell in pixels.
        down: number of cells in y, and the height of a cell in pixels.
    """
    best, at = _best_of_cells(image, x0, y0, across, down)
    # A high quantile over the cells is the texture of a good corner even if most cells show only the belt.
    place = int(len(best) * _GOOD_SHARE)
    least = np.float64(max(_WEAK * float(np.partition(best, place)[place]), _LEAST))
    return np.asarray(at[best > least])


@compiled
def _best_of_cells(
    image: NDArray[np.uint8], x0: int, y0: int, across: tuple[int, int], down: tuple[int, int]
) -> tuple[_Plane, _Ints]:
    """Return the texture of the best pixel of each cell (n,), and its x and y (n, 2)."""
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
    return best, at


@inlined
def _corners(image: NDArray[np.uint8], x0: int, y0: int, score: _Plane) -> None:
    """Write the smaller eigenvalue of the structure tensor to `score` (H, W), for the image pixels from (x0, y0) on.

    Pixels within `_REACH` of the image's border keep the value 0.
    """
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
