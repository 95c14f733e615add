"""Which components look as if they were there: their bodies have edges where the board type puts them."""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np

from vaoi_station.board_check.body_edges import BodyEdges
from vaoi_station.board_check.overview import Floats32, Overview
from vaoi_station.geometry.transforms import Floats

_BLUR_MM = 0.15
_REACH_MM = 0.3
"""Largest displacement of a component, along each axis, at which it still counts as there."""
_STEPS = (-1.0, -0.5, 0.0, 0.5, 1.0)
_ELSEWHERE = 150
"""Number of other places on the board with which each component is compared."""
_AWAY_MM = 2.0
"""Least distance of these from the component."""


def shares_weaker(overview: Overview, edges: BodyEdges, matrix: Floats) -> Floats:
    """Return for each component the share of other places of the board at which its body would show weaker edges.

    A component that is there comes near 1; one that is not has any value. Components beyond the picture have NaN.

    Args:
        overview: what was filmed.
        edges: bodies of n components.
        matrix: (3, 3) from CAD data in mm to tester coordinates.

    Returns:
        (n,).
    """
    strength = overview.edges(_BLUR_MM)
    px_from_cad = (overview.px_from_tester @ matrix)[:2]
    turn = matrix[:2, :2] / np.sqrt(abs(np.linalg.det(matrix[:2, :2])))
    at, across = edges.points @ px_from_cad[:, :2].T + px_from_cad[:, 2], (edges.normals @ turn.T) ** 2
    low, high = at.min(0), at.max(0)
    random = np.random.default_rng(1)
    out = np.full(int(edges.part.max(initial=-1)) + 1, np.nan)
    resolution = overview.px_per_mm
    parts = np.unique(edges.part)
    ends = np.searchsorted(edges.part, parts, side="right").tolist()
    for part, start, end in zip(parts.tolist(), [0, *ends], ends, strict=False):
        of = slice(start, end)
        points, normals = at[of], across[of]
        if not _inside(overview, points):
            continue
        here = _best(strength, points, normals, np.zeros((1, 2)), resolution)[0]
        # Places at which the whole body lies within the extent of all bodies, on the board that is.
        room_low, room_high = low - points.min(0), high - points.max(0)
        shifts = room_low + random.random((_ELSEWHERE, 2)) * (room_high - room_low)
        shifts = shifts[np.hypot(*shifts.T) > _AWAY_MM * resolution]
        elsewhere = _best(strength, points, normals, shifts, resolution)
        out[part] = float((elsewhere < here).mean()) if len(elsewhere) else np.nan
    return out


def _best(strength: Floats32, points: Floats, across: Floats, shifts: Floats, px_per_mm: float) -> Floats:
    """Return the mean strength along a body's edges at its best place near each of k shifts, (k,)."""
    near = np.array(list(product(_STEPS, _STEPS))) * _REACH_MM * px_per_mm
    at = (points + (shifts[:, None] + near).reshape(-1, 1, 2)).astype(np.float32)
    values = [cv2.remap(s, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=0) for s in strength]
    mean = (values[0] * across[:, 0] + values[1] * across[:, 1]).mean(1)
    return np.asarray(mean.reshape(len(shifts), len(near)).max(1), np.float64)


def _inside(overview: Overview, points: Floats) -> bool:
    x, y = np.rint(points).astype(int).T
    h, w = overview.seen.shape
    if (x < 0).any() or (y < 0).any() or (x >= w).any() or (y >= h).any():
        return False
    return bool(overview.seen[y, x].all())
