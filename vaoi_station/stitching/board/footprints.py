"""Components on the stitched board: the component under a point, and the frames that show a component's centre."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.marks.candidate_search import SURROUND
from vaoi_station.model import BoardType, Surface
from vaoi_station.stitching.adjustment.motion import points_in_box
from vaoi_station.stitching.adjustment.observations import Ints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.patch_tables import WINDOW_PX
from vaoi_station.stitching.matching.scene import Scene

_BEYOND_PX = 3.0
"""A footprint's centre up to this far outside a frame still counts as a view."""

_BORDER_PX = 6.0
"""Least distance of a fiducial's bare rim from the border of a frame: nearer to the border it may not be detected."""

View = tuple[int, int, float, float]
"""One view of a point: camera, row, and raw pixels x and y."""


def component_at(plane: BoardPlane, c: Floats, board_mm: Floats) -> Ints:
    """Return for each board point (k, 2), mm, the number of the smallest component on which it lies, or −1 for none."""
    return plane.components.find(np.asarray(np.linalg.inv(plane.matrix(c)), np.float64), board_mm)


def near_component(plane: BoardPlane, c: Floats, board_mm: Floats, scene: Scene) -> Ints:
    """Return for each board point (k, 2), mm, the number of the component that a link's patch there reaches, or −1."""
    half_patch_mm = WINDOW_PX / 2 / float(np.mean([camera.px_per_mm for camera in scene.cameras]))
    wider = plane.components.widened(half_patch_mm)
    return wider.find(np.asarray(np.linalg.inv(plane.matrix(c)), np.float64), board_mm)


def landmarks(plane: BoardPlane) -> tuple[tuple[str, ...], Floats]:
    """Return names and CAD coordinates (n, 2) of the points whose views are computed.

    These are the centres of the components or, for a board type without components, two corners of the board.
    """
    parts = plane.components
    if parts.addresses:
        return parts.addresses, parts.center
    return ("low corner", "high corner"), np.array(plane.board_type.extent())


@dataclass(frozen=True, eq=False)
class FootprintViews:
    """k views of points of the board, ordered by point, then by camera, then by row."""

    point: Ints
    """(k,) number of the point that each view shows."""
    camera: Ints
    row: Ints
    place_mm: Floats
    """(k, 2) position of the point in the conveyor's plane, mm in row coordinates, in the row of the view."""
    px: Floats
    """(k, 2) raw pixels. Some lie a little outside the frame."""

    @staticmethod
    def of(
        cad: Floats, cad_matrix: Floats, cameras: Sequence[Camera], rows: Floats, surface: Surface | None
    ) -> FootprintViews:
        """Compute the views of CAD points.

        Args:
            cad: (n, 2) points in CAD coordinates.
            cad_matrix: C, (3, 3) from CAD to tester coordinates.
            cameras: the cameras.
            rows: (m, 3, 3) the matrices D_j of the m rows.
            surface: surface of the board; None for a board in the calibrated plane.
        """
        height = surface.height_mm(cad) if surface else np.zeros(len(cad))
        # First, one box around all cameras' views is tested: in most rows no camera sees a given point.
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

    @property
    def frames(self) -> list[FrameKey]:
        """Camera and row of each of the k views."""
        return list(zip(self.camera.tolist(), self.row.tolist(), strict=True))

    def without_rows(self, rows: Sequence[int]) -> FootprintViews:
        """Return the views in all rows except the given ones."""
        return self._where(~np.isin(self.row, rows)) if rows else self

    def without_frames(self, frames: Collection[FrameKey]) -> FootprintViews:
        """Return the views in all frames except the given ones."""
        return self._where(np.array([key not in frames for key in self.frames], np.bool_)) if frames else self

    def without_points(self, points: Sequence[int]) -> FootprintViews:
        """Return the views of all points except the given ones."""
        return self._where(~np.isin(self.point, points)) if points else self

    def _where(self, keep: NDArray[np.bool_]) -> FootprintViews:
        return FootprintViews(self.point[keep], self.camera[keep], self.row[keep], self.place_mm[keep], self.px[keep])


def views_by_address(addresses: Sequence[str], views: FootprintViews) -> dict[str, tuple[View, ...]]:
    """Return the views of each footprint's centre: {address: ((camera, row, x, y), …)}, x and y in raw pixels."""
    x, y = np.round(views.px, 4).T.tolist()
    every = list(zip(views.camera.tolist(), views.row.tolist(), x, y, strict=True))
    ends = [0, *np.cumsum(np.bincount(views.point, minlength=len(addresses))).tolist()]
    return {address: tuple(every[a:b]) for address, (a, b) in zip(addresses, pairwise(ends), strict=True)}


def frames_of_marks(
    board_type: BoardType, views: FootprintViews, cameras: Sequence[Camera], confirmed: Collection[FrameKey]
) -> dict[int, FrameKey]:
    """Return one frame for each fiducial that a confirmed frame shows with its bare rim, by number of the fiducial."""
    found: dict[int, FrameKey] = {}
    for n, i, j, px in zip(views.point.tolist(), views.camera.tolist(), views.row.tolist(), views.px, strict=True):
        reach_px = SURROUND / 2 * board_type.fiducials[n].diameter * board_type.mm_per_unit * cameras[i].px_per_mm
        if (i, j) in confirmed and cameras[i].sees(px[None], reach_px + _BORDER_PX)[0]:
            found.setdefault(n, (i, j))
    return found
