"""Components on the stitched board: the one under each point, and the views of their centres in the frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import Surface
from vaoi_station.stitching.adjustment.motion import points_in_box
from vaoi_station.stitching.adjustment.observations import Ints
from vaoi_station.stitching.board.board_plane import BoardPlane

_BEYOND_PX = 3.0
"""Largest distance outside the frame at which the centre of a footprint still counts as a view."""

View = tuple[int, int, float, float]
"""Camera, row, and raw pixels."""


def component_at(plane: BoardPlane, c: Floats, board_mm: Floats) -> Ints:
    """Find the number of the component under each board point (k, 2); −1 for none; the smallest wins."""
    return plane.components.find(np.asarray(np.linalg.inv(plane.matrix(c)), np.float64), board_mm)


def landmarks(plane: BoardPlane) -> tuple[tuple[str, ...], Floats]:
    """Return names and CAD places (n, 2) of the points whose views are computed: components, or the board's corners."""
    parts = plane.components
    if parts.addresses:
        return parts.addresses, parts.center
    return ("low corner", "high corner"), np.array(plane.board_type.extent())


@dataclass(frozen=True, eq=False)
class FootprintViews:
    """k views of points of the board, point by point, each in the order of cameras and rows."""

    point: Ints
    """(k,) number of the point."""
    camera: Ints
    row: Ints
    place_mm: Floats
    """(k, 2) place of the point on the conveyor's plane in that row."""
    px: Floats
    """(k, 2) raw pixels; some lie a little outside the frame."""

    @staticmethod
    def of(
        cad: Floats, cad_matrix: Floats, cameras: Sequence[Camera], rows: Floats, surface: Surface | None
    ) -> FootprintViews:
        """Compute the views of CAD points (n, 2); `rows` (m, 3, 3) are the D_j."""
        height = surface.height_mm(cad) if surface else np.zeros(len(cad))
        # One search over all cameras' boxes first: most pairs of point and row are out of view of every camera.
        between = float(height.min()), float(height.max())
        boxes = np.array([camera.view_mm(-_BEYOND_PX, between) for camera in cameras])
        row, point, place = points_in_box(rows, apply(cad_matrix, cad), boxes[:, 0].min(0), boxes[:, 1].max(0))
        (x, y), found = place.T, []
        for i, (camera, (low, high)) in enumerate(zip(cameras, boxes, strict=True)):
            near = np.flatnonzero((x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1]))
            px = camera.project(place[near], height[point[near]])
            seen = camera.sees(px, -_BEYOND_PX)
            at = near[seen]
            found.append((point[at], np.full(len(at), i), row[at], place[at], px[seen]))
        point, *others = (np.concatenate(of_cameras) for of_cameras in zip(*found, strict=True))
        # Views were found camera by camera; the stable sort orders them by point and keeps cameras and rows.
        order = np.argsort(point, kind="stable")
        return FootprintViews(point[order], *(values[order] for values in others))


def views_by_address(addresses: Sequence[str], views: FootprintViews) -> dict[str, tuple[View, ...]]:
    """List the views of every footprint's centre: {address: ((camera, row, x, y), …)}, in raw pixels."""
    x, y = np.round(views.px, 4).T.tolist()
    every = list(zip(views.camera.tolist(), views.row.tolist(), x, y, strict=True))
    ends = [0, *np.cumsum(np.bincount(views.point, minlength=len(addresses))).tolist()]
    return {address: tuple(every[a:b]) for address, (a, b) in zip(addresses, pairwise(ends), strict=True)}
