"""A stitched run with its frames, as the modules of this room read it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from vaoi_station.board_check.overview import Frame, Overview, make_overview
from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Stitch, Surface
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.geometry import FootprintViews, FrameIndex
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene

_MOST_PREPARED = 24
"""Number of frames that are kept in memory; components are measured frame by frame."""


@dataclass(frozen=True, eq=False)
class CheckedRun:
    """A stitched run, its frames, and the board type with which it was stitched."""

    stitch: Stitch
    cameras: tuple[Camera, ...]
    """The cameras as in the run."""
    frame: Frame
    lights: tuple[str, ...] = ()
    board_type: BoardType | None = None
    """The board type to which C of the run belongs; None without one."""

    @cached_property
    def overview(self) -> Overview:
        """The picture of all that was filmed."""
        return make_overview(self.stitch, self.cameras, self.frame, self.lights)

    @cached_property
    def motion(self) -> Motion:
        """The motion of the rows."""
        back = np.linalg.inv(np.array(self.stitch.row_motion))
        return Motion(np.arctan2(back[:, 1, 0], back[:, 0, 0]), back[:, :2, 2].copy(), np.zeros(2))

    @cached_property
    def scene(self) -> Scene:
        """The cameras and the placed frames."""
        placed = [
            (i, j)
            for i, rows in enumerate(self.stitch.image_matrices)
            for j, matrix in enumerate(rows)
            if matrix is not None
        ]

        @lru_cache(maxsize=_MOST_PREPARED)
        def prepared(key: tuple[int, int]) -> PreparedFrame:
            pixels = self.frame(*key)
            if pixels is None:
                raise LookupError(key)
            return PreparedFrame(pixels)

        return Scene(self.cameras, tuple(key for key in placed if self.frame(*key) is not None), prepared)

    def views(self, cad: Floats, tester_from_cad: Floats) -> FootprintViews:
        """Return the views of CAD points (n, 2) on a board that is flat at the height of the run's board."""
        # Tilt and bow are known in the coordinates of the run's board type only; they move a point by micrometres.
        surface = Surface(lift_mm=self.stitch.surface.lift_mm) if self.stitch.surface else None
        rows = np.array(self.stitch.row_motion)
        return FrameIndex(self.cameras, rows, surface=surface).views(cad, tester_from_cad)

    def stated_matrix(self, board: BoardType) -> Floats | None:
        """Return C of the run for data in the unit and axes of another board type; None if the run has no C."""
        c, own = self.stitch.cad_matrix, self.board_type
        if c is None or own is None:
            return None
        flip = 1.0 if own.y_axis == board.y_axis else -1.0
        ratio = board.mm_per_unit / own.mm_per_unit
        return np.asarray(np.array(c) @ np.diag([ratio, flip * ratio, 1.0]))
