"""Components on the stitched board: which link lies on which, and where their centres are in the frames."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import Surface
from vaoi_station.stitching.cad import Frame
from vaoi_station.stitching.motion import places_within
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
    parts: Parts, cad_matrix: Floats, cameras: Sequence[Camera], rows: Floats, surface: Surface | None
) -> dict[str, tuple[View, ...]]:
    """Raw pixels of the centre of each footprint in every frame that shows it: {address: [(camera, row, x, y)]}.

    `rows` (m, 3, 3) are the D_j.
    """
    n = len(parts.addresses)
    if not n:
        return {}
    height = surface.height_mm(parts.center) if surface else np.zeros(n)
    between = float(height.min()), float(height.max())
    board = apply(cad_matrix, parts.center)
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
