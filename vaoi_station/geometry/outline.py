"""Whether a point lies on the board: outlines are two opposite corners or a polygon."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

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
