"""Homographies of rectangles, and the tiles of a picture in which a lens bends lines too much for one matrix."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.rendering.view import Tile

_TILE_PX = 0.003
"""Largest deviation of a tile's homography from the lens, px.

It moves the grey level of a steep edge, 150 levels from pixel to pixel, by less than half a level."""
_MOST_TILES = 24
"""Largest number of tiles along one side of a picture; no usable lens needs as many."""


def cut_tiles(
    matrices: Floats, size: Floats, bend_px: Floats, distort: Callable[[NDArray[np.int_], Floats], Floats]
) -> list[tuple[Tile, ...]]:
    """Cut each of k pictures into tiles, whose corners are mapped through the lens exactly; return the tiles of each.

    Args:
        matrices: (k, 3, 3) from pixels of the picture to undistorted pixels of the frame.
        size: (k, 2) width and height of the pictures.
        bend_px: (k,) largest deviation of the lens from a homography over the whole picture.
        distort: function that takes the number of a picture for each of t tiles, and undistorted pixels (t, 4, 2) of
            their corners; it returns raw pixels.
    """
    # The deviation falls with the square of the number of tiles along a side.
    parts = np.ceil(np.sqrt(np.minimum(bend_px / _TILE_PX, _MOST_TILES**2))).astype(int)
    boxes: list[tuple[int, int, int, int]] = []
    of = []
    for (width, height), n in zip(size.astype(int).tolist(), parts.tolist(), strict=True):
        # About square tiles: along its shorter side a picture needs fewer.
        longer = max(width, height)
        own = rectangles(width, height, math.ceil(n * width / longer), math.ceil(n * height / longer))
        boxes += own
        of.append(len(own))
    # All tiles of all pictures at once: most pictures have few tiles.
    x0, y0, x1, y1 = np.array(boxes, dtype=np.float64).T - 0.5
    corners = np.stack([x0, y0, x1, y0, x1, y1, x0, y1], -1).reshape(-1, 4, 2)
    picture = np.repeat(np.arange(len(of)), of)
    raw = distort(picture, through(matrices[picture], corners))
    found = rectangle_homographies(corners - corners[:, :1] - 0.5, raw)
    tiles = list(map(Tile, *zip(*boxes, strict=True), found))
    ends = np.cumsum(of).tolist()
    return [tuple(tiles[begin:end]) for begin, end in zip([0, *ends], ends, strict=False)]


def rectangle_homographies(source: Floats, target: Floats) -> Floats:
    """Compute k homographies (k, 3, 3), each from the corners of an upright rectangle to four points.

    Args:
        source: (k, 4, 2) corners of the rectangles: top left, top right, bottom right, bottom left.
        target: (k, 4, 2) the points that they are mapped to.

    Returns:
        The homographies; NaN for a rectangle that is less than a pixel wide or high: it has no four distinct corners.
    """
    # In closed form, by way of the unit square (Heckbert 1989, section 2.2.3): a solver takes ten times as long.
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = target.transpose(1, 2, 0)
    left, top = source[:, 0].T
    width, height = (source[:, 2] - source[:, 0]).T
    flat = (width < 1) | (height < 1)
    width, height = np.where(flat, np.nan, width), np.where(flat, np.nan, height)
    ax, bx, ay, by = x1 - x2, x3 - x2, y1 - y2, y3 - y2
    sx, sy, area = x0 - x1 + x2 - x3, y0 - y1 + y2 - y3, ax * by - bx * ay
    area = np.where(flat | (area == 0), np.nan, area)
    g, h = (sx * by - bx * sy) / area, (ax * sy - sx * ay) / area
    columns = np.empty((len(source), 3, 3))
    columns[:, 0] = np.stack([x1 - x0 + g * x1, y1 - y0 + g * y1, g], -1) / width[:, None]
    columns[:, 1] = np.stack([x3 - x0 + h * x3, y3 - y0 + h * y3, h], -1) / height[:, None]
    columns[:, 2] = np.stack([x0, y0, np.ones_like(x0)], -1)
    columns[:, 2] -= columns[:, 0] * left[:, None] + columns[:, 1] * top[:, None]
    # In the order of C: compiled functions are compiled anew for matrices of another order.
    return np.divide(columns.swapaxes(1, 2), columns[:, 2, 2, None, None], order="C")


def rectangles(width: int, height: int, columns: int, rows: int) -> list[tuple[int, int, int, int]]:
    """Cut a picture into about equal parts; return x0, y0, x1, y1 of each, ends excluded."""
    # OpenCV computes 16 pixels of a row at a time, and the rest of a row one by one.
    x, y = _cuts(width, columns, 16 if width >= 32 * columns else 1), _cuts(height, rows, 1)
    return [(a, b, c, d) for b, d in pairwise(y) for a, c in pairwise(x)]


def _cuts(length: int, parts: int, step: int) -> list[int]:
    """Return the positions, both ends included, at which a side of this length is cut into parts.

    Positions between the ends are multiples of `step`.
    """
    parts = max(min(parts, length // 2), 1)
    return [0, *(round(k * length / parts / step) * step for k in range(1, parts)), length]


def through(matrices: Floats, points: Floats) -> Floats:
    """Project n points of each of k pictures, (k, n, 2), by one matrix per picture, (k, 3, 3), to pixels (k, n, 2)."""
    # In memory, coordinates follow each other point by point: numpy is slow in loops over nine points or three rows.
    (x, y), rows = points.T, matrices.transpose(1, 2, 0)
    q = rows[:, 0, None] * x + rows[:, 1, None] * y + rows[:, 2, None]
    return np.asarray((q[:2] / q[2]).T)
