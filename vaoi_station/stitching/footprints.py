"""Components on the stitched board: which link lies on which, and where their centres are in the frames."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from vaoi_station.compiled import compiled
from vaoi_station.geometry import Camera, Euclidean
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import Surface
from vaoi_station.stitching.cad import Frame
from vaoi_station.stitching.observations import Ints
from vaoi_station.stitching.parts import Parts

_BEYOND_PX = 3.0
"""Views are listed until the centre is so far outside the frame."""

View = tuple[int, int, float, float]
"""Camera, row, and raw pixels."""


def component_of(frame: Frame, c: Floats, board_mm: Floats) -> Ints:
    """Number of the component on whose footprint each board point (k, 2) lies; −1 for none; the smallest wins."""
    return frame.parts.under(np.asarray(np.linalg.inv(frame.matrix(c)), np.float64), board_mm)


def footprint_views(
    parts: Parts, cad_matrix: Floats, cameras: Sequence[Camera], motion: Sequence[Euclidean], surface: Surface | None
) -> dict[str, tuple[View, ...]]:
    """Raw pixels of the centre of each footprint in every frame that shows it: {address: [(camera, row, x, y)]}."""
    n = len(parts.addresses)
    if not n:
        return {}
    height = surface.height_mm(parts.center) if surface else np.zeros(n)
    between = float(height.min()), float(height.max())
    board, rows = apply(cad_matrix, parts.center), np.array([d.matrix for d in motion])
    found = []
    for i, camera in enumerate(cameras):
        row, part, place = places_within(rows, board, *camera.view_mm(-_BEYOND_PX, between))
        px = camera.project(place, height[part])
        seen = camera.sees(px, -_BEYOND_PX)
        found.append((part[seen], np.full(int(seen.sum()), i), row[seen], px[seen]))
    part, camera_of, row_of, px = (np.concatenate(of_cameras) for of_cameras in zip(*found, strict=True))
    order = np.argsort(part, kind="stable")
    x, y = np.round(px[order], 4).T.tolist()
    views = list(zip(camera_of[order].tolist(), row_of[order].tolist(), x, y, strict=True))
    ends = [0, *np.cumsum(np.bincount(part, minlength=n)).tolist()]
    return {address: tuple(views[a:b]) for address, (a, b) in zip(parts.addresses, pairwise(ends), strict=True)}


@compiled
def places_within(rows: Floats, board_mm: Floats, low: Floats, high: Floats) -> tuple[Ints, Ints, Floats]:
    """Which points of the board come into a box, in which rows, and where they are then.

    Args:
        rows: (m, 3, 3) D_j.
        board_mm: (k, 2) tester coordinates.
        low: (2,) lowest corner of the box on the conveyor's plane.
        high: (2,) highest corner.

    Returns:
        Row (v,) and number of the point (v,), row by row, and the place (v, 2) in row coordinates.
    """
    most = len(rows) * len(board_mm)
    row, point, place = np.empty(most, np.int64), np.empty(most, np.int64), np.empty((most, 2))
    count = 0
    for j in range(len(rows)):
        d = rows[j]
        for n in range(len(board_mm)):
            x = d[0, 0] * board_mm[n, 0] + d[0, 1] * board_mm[n, 1] + d[0, 2]
            y = d[1, 0] * board_mm[n, 0] + d[1, 1] * board_mm[n, 1] + d[1, 2]
            if low[0] <= x <= high[0] and low[1] <= y <= high[1]:
                row[count], point[count], place[count, 0], place[count, 1] = j, n, x, y
                count += 1
    return row[:count].copy(), point[:count].copy(), place[:count].copy()
