"""Homographies of rectangles, and the tiles of a picture in which a lens bends lines too much for one matrix."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.rendering.view import Tile

_TILE_PX = 0.005
"""Largest deviation of a tile's homography from the lens, px.

It moves the grey level of the sharpest edge that an 8-bit frame can show by about one level."""
_MOST_TILES = 24
"""Largest number of tiles along one side of a picture; no usable lens needs as many."""


def cut_tiles(camera: Camera, matrices: Floats, size: Floats, bend_px: Floats) -> list[tuple[Tile, ...]]:
    """Cut each of k pictures into tiles, whose corners are mapped through the lens exactly; return the tiles of each.

    Args:
        camera: the camera, whose lens is used.
        matrices: (k, 3, 3) from pixels of the picture to undistorted pixels of the frame.
        size: (k, 2) width and height of the pictures.
        bend_px: (k,) largest deviation of the lens from a homography over the whole picture.
    """
    # The deviation falls with the square of the number of tiles along a side.
    parts = np.ceil(np.sqrt(np.minimum(bend_px / _TILE_PX, _MOST_TILES**2))).astype(int)
    boxes, of = [], []
    for (width, height), n in zip(size.astype(int).tolist(), parts.tolist(), strict=True):
        x, y = _cuts(width, n), _cuts(height, n)
        boxes += [(a, b, c, d) for b, d in pairwise(y) for a, c in pairwise(x)]
        of.append((len(x) - 1) * (len(y) - 1))
    # All tiles of all pictures at once: most pictures have few tiles.
    x0, y0, x1, y1 = np.array(boxes, dtype=np.float64).T - 0.5
    corners = np.stack([x0, y0, x1, y0, x1, y1, x0, y1], -1).reshape(-1, 4, 2)
    raw = camera.lens.distort(through(np.repeat(matrices, of, axis=0), corners))
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
    return np.asarray(columns.swapaxes(1, 2) / columns[:, 2, 2, None, None])


def _cuts(length: int, parts: int) -> list[int]:
    """Return the positions, both ends included, at which a side of this length is cut into tiles."""
    parts = max(min(parts, length // 2), 1)
    return [k * length // parts for k in range(parts + 1)]


def through(matrices: Floats, points: Floats) -> Floats:
    """Project n points of each of k pictures, (k, n, 2), by one matrix per picture, (k, 3, 3), to pixels (k, n, 2)."""
    q = points @ matrices[:, :, :2].swapaxes(1, 2) + matrices[:, None, :, 2]
    return np.asarray(q[..., :2] / q[..., 2:])
