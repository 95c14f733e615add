"""Outlines of boards, two opposite corners or a polygon: whether a point lies on the board, whether edges cross."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

_ON_THE_EDGE = 1e-9


def encloses(outline: Sequence[tuple[float, float]], point: ArrayLike) -> bool:
    """Whether a point lies inside an outline or on its edge.

    Args:
        outline: two opposite corners of a box, or at least three corners of a polygon in order.
        point: (2,), in the same coordinates.
    """
    corners = np.asarray(outline, dtype=np.float64)
    p = np.asarray(point, dtype=np.float64)
    tolerance = _ON_THE_EDGE * float(np.ptp(corners, axis=0).max())
    if len(corners) == 2:
        low, high = corners.min(0) - tolerance, corners.max(0) + tolerance
        return bool(((low <= p) & (p <= high)).all())
    a, b = corners, np.roll(corners, -1, axis=0)
    along = b - a
    t = np.clip(((p - a) * along).sum(1) / np.maximum((along**2).sum(1), 1e-300), 0, 1)
    if np.hypot(*(a + t[:, None] * along - p).T).min() <= tolerance:
        return True
    crosses = (a[:, 1] > p[1]) != (b[:, 1] > p[1])
    at_x = a[crosses, 0] + (p[1] - a[crosses, 1]) * along[crosses, 0] / along[crosses, 1]
    return bool((at_x > p[0]).sum() % 2)


def find_crossing_edges(outline: Sequence[tuple[float, float]]) -> tuple[int, int] | None:
    """Two edges of a polygon that cross or touch though they are no neighbours, by the number of their first corner.

    Args:
        outline: at least three corners in order; two opposite corners have no edges to cross.
    """
    a = np.asarray(outline, dtype=np.float64)
    n = len(a)
    b = np.roll(a, -1, axis=0)
    for i in range(n - 2 if n > 3 else 0):
        j = np.arange(i + 2, n - (i == 0))
        apart = _side(a[i], b[i], a[j]) * _side(a[i], b[i], b[j]) <= 0
        apart &= _side(a[j], b[j], a[i]) * _side(a[j], b[j], b[i]) <= 0
        low, high = np.minimum(a[i], b[i]), np.maximum(a[i], b[i])
        apart &= ((np.minimum(a[j], b[j]) <= high) & (np.maximum(a[j], b[j]) >= low)).all(-1)
        if apart.any():
            return i, int(j[apart.argmax()])
    return None


def _side(a: ArrayLike, b: ArrayLike, p: ArrayLike) -> NDArray[np.float64]:
    """-1, 0 or 1: on which side of the line from a to b a point lies."""
    along, to = np.subtract(b, a), np.subtract(p, a)
    return np.asarray(np.sign(along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]))
