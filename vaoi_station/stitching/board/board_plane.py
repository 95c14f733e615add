"""The plane of a board type, and its handedness against the tester.

C has four parameters (`Similarity`) and cannot mirror by itself. `BoardPlane` takes the mirror out of the CAD data, so
that the rest of the stitching computes with rotations only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType
from vaoi_station.stitching.board.component_index import ComponentIndex
from vaoi_station.stitching.board.expectation import Expectation


@dataclass(frozen=True, eq=False)
class BoardPlane:
    """The CAD plane of a board type, with its y axis flipped where C mirrors: flat coordinates, in CAD units."""

    board_type: BoardType
    mirrored: bool
    """Whether C changes handedness."""

    @cached_property
    def components(self) -> ComponentIndex:
        """The components as arrays."""
        return ComponentIndex.of(self.board_type)

    def flat(self, cad: Floats) -> Floats:
        """Convert CAD points (k, 2) to flat coordinates, which `adjustment.apply_similarity` takes."""
        return np.asarray(cad, dtype=np.float64) * (1.0, -1.0 if self.mirrored else 1.0)

    def cad(self, flat: Floats) -> Floats:
        """Convert flat coordinates (k, 2) to CAD points."""
        # A flip is its own inverse.
        return self.flat(flat)

    def matrix(self, c: Floats) -> Floats:
        """Build C as a 3×3 matrix, CAD → tester, from its parameters (a, b, x, y)."""
        a, b, x, y = c
        f = -1.0 if self.mirrored else 1.0
        return np.array([[a, -b * f, x], [b, a * f, y], [0, 0, 1.0]])

    @property
    def fiducials(self) -> Floats:
        """Flat coordinates (k, 2) of the board's fiducials."""
        return self.flat(np.array([(f.x, f.y) for f in self.board_type.fiducials]).reshape(-1, 2))


def board_plane(board_type: BoardType, camera: Camera) -> BoardPlane:
    """Make the plane of a board type as a camera of the array sees it.

    CAD → image mirrors exactly when "y up" differs from "bottom side" (docs/conventions.md, handedness); the camera's
    own mirror is taken out of that.
    """
    # Handedness is never fitted: two fiducials fit either way, and a symmetric board fits both.
    return BoardPlane(board_type, board_type.mirrors != camera.image_from_row.mirrors)


def expected_angle(plane: BoardPlane, camera: Camera, expectation: Expectation) -> float:
    """Compute the direction in the tester of the flat x axis, in rad, if the board lies as expected."""
    upright = np.pi if plane.board_type.side == "bottom" else 0.0
    turn = upright + expectation.angle_rad
    middle = np.asarray(camera.center_px)
    # The expectation is given as the cameras see the board. One pixel in that direction becomes a direction in mm.
    way = camera.row_from_image(np.stack([middle, middle + (np.cos(turn), np.sin(turn))]))
    return float(np.arctan2(*(way[1] - way[0])[::-1]))
