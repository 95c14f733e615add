"""Components on the stitched board: which link lies on which, and where their centres are in the frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vaoi_station.geometry import Camera, Euclidean
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Surface
from vaoi_station.stitching.cad import Frame
from vaoi_station.stitching.observations import Ints

_AROUND_MM = 0.3
"""A part's solder and shadow belong to it."""
_BEYOND_PX = 3.0
"""Views are listed until the centre is so far outside the frame."""


def component_of(frame: Frame, c: Floats, board_mm: Floats) -> Ints:
    """Number of the component on whose footprint each board point (k, 2) lies; −1 for none; the smallest wins."""
    board_type = frame.board_type
    cad = apply(np.linalg.inv(frame.matrix(c)), board_mm)
    out = np.full(len(cad), -1)
    around = _AROUND_MM / board_type.mm_per_unit
    bodies = [(n, p) for n, p in enumerate(board_type.components) if p.body_height is None or p.body_height > 0]
    for n, part in sorted(bodies, key=lambda b: -b[1].width * b[1].height):
        a = np.radians(part.rotation if board_type.y_axis == "up" else -part.rotation)
        offset = (cad - part.center) @ np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
        out[(np.abs(offset) <= (part.width / 2 + around, part.height / 2 + around)).all(1)] = n
    return out


def footprint_views(
    board_type: BoardType,
    cad_matrix: Floats,
    cameras: Sequence[Camera],
    motion: Sequence[Euclidean],
    surface: Surface | None,
) -> dict[str, tuple[tuple[int, int, float, float], ...]]:
    """Raw pixels of the centre of each footprint in every frame that shows it: {address: [(camera, row, x, y)]}."""
    parts = board_type.components
    if not parts:
        return {}
    centers = np.array([p.center for p in parts])
    board = apply(cad_matrix, centers)
    height = surface.height_mm(centers) if surface else np.zeros(len(parts))
    views: list[list[tuple[int, int, float, float]]] = [[] for _ in parts]
    for i, camera in enumerate(cameras):
        for j, d in enumerate(motion):
            px = camera.project(d(board), height)
            for n in np.flatnonzero(camera.sees(px, -_BEYOND_PX)):
                views[n].append((i, j, round(float(px[n, 0]), 4), round(float(px[n, 1]), 4)))
    return {p.address: tuple(v) for p, v in zip(parts, views, strict=True)}
