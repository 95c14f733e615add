"""Board outlines as polygons, or boxes given by two opposite corners: containment and self-intersection."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

_EDGE_TOLERANCE = 1e-9
"""Distance at which a point counts as lying on an edge, as a share of the outline's extent: rounding only."""


def encloses(outline: Sequence[tuple[float, float]] | NDArray[np.float64], point: ArrayLike) -> bool:
    """Return whether a point lies inside an outline or on its edge.

    Args:
        outline: two opposite corners of a box, or at least three polygon corners in order.
        point: (2,), in the coordinates of the outline.
    """
    corners = np.asarray(outline, dtype=np.float64)
    p = np.asarray(point, dtype=np.float64)
    tolerance = _EDGE_TOLERANCE * float(np.ptp(corners, axis=0).max())
    if len(corners) == 2:
        low, high = corners.min(0) - tolerance, corners.max(0) + tolerance
        return bool(((low <= p) & (p <= high)).all())
    # First, the distance to each edge is tested: the crossing count below is undefined for points on an edge.
    a, b = corners, np.roll(corners, -1, axis=0)
    along = b - a
    t = np.clip(((p - a) * along).sum(1) / np.maximum((along**2).sum(1), 1e-300), 0, 1)
    if np.hypot(*(a + t[:, None] * along - p).T).min() <= tolerance:
        return True
    # Even-odd rule with a ray to the right. The half-open comparison counts a corner for one of its two edges only.
    crosses = (a[:, 1] > p[1]) != (b[:, 1] > p[1])
    at_x = a[crosses, 0] + (p[1] - a[crosses, 1]) * along[crosses, 0] / along[crosses, 1]
    return bool((at_x > p[0]).sum() % 2)


def find_crossing_edges(outline: Sequence[tuple[float, float]]) -> tuple[int, int] | None:
    """Find two non-adjacent edges of a polygon that cross or touch.

    Args:
        outline: at least three corners in order; for two opposite corners None is returned.

    Returns:
        The indices of the first corners of both edges, or None.
    """
    corners = np.asarray(outline, dtype=np.float64)
    n = len(corners)
    if n <= 3:
        return None
    ends = np.roll(corners, -1, axis=0)
    low, high = np.minimum(corners, ends), np.maximum(corners, ends)
    # Only edges whose bounding boxes overlap can meet. The edges are sorted by their left ends. Those that begin left
    # of the right end of an edge are then neighbours in this order, so that most pairs need no test.
    order = np.argsort(low[:, 0], kind="stable")
    lefts = low[order, 0]
    until = np.searchsorted(lefts, high[order, 0], side="right")
    for k, i in enumerate(order.tolist()):
        j = order[k + 1 : until[k]]
        j = j[(low[j, 1] <= high[i, 1]) & (high[j, 1] >= low[i, 1])]
        # Neighbouring edges share a corner; so do the last and the first.
        j = j[((j - i) % n != 1) & ((i - j) % n != 1)]
        if len(j):
            meet = _side(corners[i], ends[i], corners[j]) * _side(corners[i], ends[i], ends[j]) <= 0
            meet &= _side(corners[j], ends[j], corners[i]) * _side(corners[j], ends[j], ends[i]) <= 0
            if meet.any():
                other = int(j[meet].min())
                return min(i, other), max(i, other)
    return None


def _side(a: ArrayLike, b: ArrayLike, p: ArrayLike) -> NDArray[np.float64]:
    """Return the side of the line from a to b on which the point p lies: −1, 0 (on the line) or 1."""
    along, to = np.subtract(b, a), np.subtract(p, a)
    return np.asarray(np.sign(along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]))


def pixels_inside(corners: NDArray[np.float64], width: int, height: int) -> NDArray[np.bool_]:
    """Return which pixel centres (height, width) lie inside a convex polygon (n, 2), or on its edge."""
    y, x = np.mgrid[:height, :width]
    along = np.roll(corners, -1, axis=0) - corners
    side = along[:, 0] * (y[..., None] - corners[:, 1]) - along[:, 1] * (x[..., None] - corners[:, 0])
    # All sides have the sign of the polygon's turn where the point is inside.
    turn = np.sign(along[0, 0] * along[1, 1] - along[0, 1] * along[1, 0])
    return np.asarray((side * turn >= 0).all(-1))
