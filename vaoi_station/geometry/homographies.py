"""Homographies of pictures: from the corners of rectangles, between reduced grids, and of parts of pictures."""

from __future__ import annotations

import numpy as np

from vaoi_station.geometry.transforms import Floats


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
    columns = np.empty((len(target), 3, 3))
    columns[:, 0] = np.stack([x1 - x0 + g * x1, y1 - y0 + g * y1, g], -1) / width[:, None]
    columns[:, 1] = np.stack([x3 - x0 + h * x3, y3 - y0 + h * y3, h], -1) / height[:, None]
    columns[:, 2] = np.stack([x0, y0, np.ones_like(x0)], -1)
    columns[:, 2] -= columns[:, 0] * left[:, None] + columns[:, 1] * top[:, None]
    # In the order of C: compiled functions are compiled anew for matrices of another order.
    return np.divide(columns.swapaxes(1, 2), columns[:, 2, 2, None, None], order="C")


def through(matrices: Floats, points: Floats) -> Floats:
    """Project n points of each of k pictures, (k, n, 2), by one matrix per picture, (k, 3, 3), to pixels (k, n, 2)."""
    # In memory, coordinates follow each other point by point: numpy is slow in loops over nine points or three rows.
    (x, y), rows = points.T, matrices.transpose(1, 2, 0)
    q = rows[:, 0, None] * x + rows[:, 1, None] * y + rows[:, 2, None]
    return np.asarray((q[:2] / q[2]).T)


def between(matrix: Floats, target: float, source: float) -> Floats:
    """Return a matrix between grids whose pixels are `target` and `source` times as large as those of `matrix`."""
    found = np.array(matrix, np.float64)
    if target != 1:
        found[:2] = found[:2] / target + (0.5 / target - 0.5) * found[2]
    if source != 1:
        found[:, 2] += (0.5 * source - 0.5) * (found[:, 0] + found[:, 1])
        found[:, :2] *= source
    return found


def of_part(matrix: Floats, x0: float, y0: float) -> Floats:
    """Return the matrix (2 or 3, 3) from pixels of a part of a picture that begins at (x0, y0)."""
    found = matrix.copy()
    found[:, 2] += x0 * matrix[:, 0] + y0 * matrix[:, 1]
    return found


def to_part(matrix: Floats, x0: float, y0: float) -> Floats:
    """Return the matrix (3, 3) to pixels of a part of the target that begins at (x0, y0)."""
    found = matrix.copy()
    found[0] -= x0 * matrix[2]
    found[1] -= y0 * matrix[2]
    return found
