"""The CAD plane of a board type, and whether C mirrors it.

C has four parameters (`Similarity`), which cannot express a mirror. `BoardPlane` removes the mirror from the CAD data,
so that the rest of the stitching computes with rotations only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats, Projective, System
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.problem import FiducialPoints, Ints
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.geometry import ComponentIndex

_ALIKE_RAD, _ROUNDING = np.radians(3.0), 1e-6
"""Largest angle (rad) between two cameras that count as mounted alike; tolerance of sums for rounding errors."""


@dataclass(frozen=True, eq=False)
class BoardPlane:
    """The CAD plane of a board type. Its flat coordinates are CAD coordinates, with y negated if C mirrors."""

    board_type: BoardType
    mirrored: bool
    """Whether C mirrors, that is, changes the handedness of coordinates."""

    @cached_property
    def components(self) -> ComponentIndex:
        """The components of the board type, as arrays with a search grid."""
        return ComponentIndex.of(self.board_type)

    def flat(self, cad: Floats) -> Floats:
        """Convert CAD points (k, 2) to flat coordinates, the input of `adjustment.apply_similarity`."""
        return np.asarray(cad, dtype=np.float64) * (1.0, -1.0 if self.mirrored else 1.0)

    def cad(self, flat: Floats) -> Floats:
        """Convert points (k, 2) in flat coordinates to CAD coordinates."""
        # A flip is its own inverse.
        return self.flat(flat)

    def matrix(self, c: Floats) -> Floats:
        """Build C as a 3×3 matrix from CAD to tester coordinates, from its parameters c = (a, b, x, y)."""
        a, b, x, y = c
        f = -1.0 if self.mirrored else 1.0
        return np.array([[a, -b * f, x], [b, a * f, y], [0, 0, 1.0]])

    @cached_property
    def extent(self) -> tuple[Floats, Floats]:
        """The lowest and the highest corner of the board's extent, in CAD units."""
        return self.board_type.extent()

    @cached_property
    def fiducials(self) -> Floats:
        """Flat coordinates (k, 2) of the k fiducials of the board type."""
        return self.flat(np.array([(f.x, f.y) for f in self.board_type.fiducials]).reshape(-1, 2))

    def placing(self, points: FiducialPoints) -> list[int]:
        """Return the numbers of the found fiducials that have a part in C, in order."""
        found = set(points.which[points.which >= 0].tolist())
        return sorted(found - self.board_type.apart_from_c(found, points.fixture_marks))


def board_plane(board_type: BoardType, camera: Camera) -> BoardPlane:
    """Make the plane of a board type: decide whether C mirrors, from the CAD data and one camera of the array.

    The product of C and the camera matrix mirrors if exactly one of "y up" and "bottom side" holds
    (docs/conventions.md, handedness).
    """
    # Handedness is never fitted to detections: two fiducials, or a symmetric board, fit mirrored data as well.
    return BoardPlane(board_type, board_type.mirrors != camera.image_from_row.mirrors)


def typical_camera(cameras: Sequence[Camera]) -> Camera:
    """Return a camera that is mounted as most cameras of the array are; the first one if all are mounted alike.

    A board's expected rotation is stated as a camera sees it. If cameras are upside down or rolled, the direction of
    image x on which most of them agree is rounded to the nearest axis of the tester; if no camera has it, the first one
    is returned, rolled to it.
    """
    directions = np.array([_direction(c, 0.0) for c in cameras])
    if (np.cos(directions - directions[0]) >= np.cos(_ALIKE_RAD)).all():
        return cameras[0]
    agreement = np.cos(directions[:, None] - directions).sum(1)
    most = directions[np.flatnonzero(agreement >= agreement.max() - _ROUNDING)[0]]
    upright = np.round(most / (np.pi / 2)) * (np.pi / 2)
    nearest = int(np.argmax(np.round(np.cos(directions - upright), 3)))
    if np.cos(directions[nearest] - upright) >= np.cos(_ALIKE_RAD):
        return cameras[nearest]
    camera, turn = cameras[0], upright - directions[0]
    turn = turn if camera.image_from_row.mirrors else -turn
    (u, v), c, s = camera.center_px, np.cos(turn), np.sin(turn)
    rolled = np.array([[c, -s, u - c * u + s * v], [s, c, v - s * u - c * v], [0.0, 0.0, 1.0]])
    matrix = Projective(rolled @ camera.image_from_row.matrix, System.IMAGE, System.ROW)
    return replace(camera, image_from_row=matrix)


def _direction(camera: Camera, angle_rad: float) -> float:
    """Return the direction of an angle in the image, in tester coordinates, rad."""
    middle = np.asarray(camera.center_px)
    way = camera.row_from_image(np.stack([middle, middle + (np.cos(angle_rad), np.sin(angle_rad))]))
    return float(np.arctan2(*(way[1] - way[0])[::-1]))


def expected_angle(plane: BoardPlane, camera: Camera, expectation: Expectation) -> float:
    """Compute the expected direction of the x axis of flat coordinates, as an angle in tester coordinates, rad."""
    return _direction(camera, (np.pi if plane.board_type.side == "bottom" else 0.0) + expectation.angle_rad)


def turned_by_flip(cameras: Sequence[Camera], angle_rad: float, axis: Literal["x", "y"]) -> bool:
    """Return whether a board lies turned by 180° against how its other side lay, once it is turned over about an axis.

    `angle_rad` is the rotation in the image at which the other side lay. CAD "up" stays where it is if it is along the
    axis of the tester, and is reversed if it is across.
    """
    up = _direction(typical_camera(cameras), angle_rad - np.pi / 2)
    return bool(abs(np.cos(up)) > abs(np.sin(up))) != (axis == "x")


def component_at(plane: BoardPlane, c: Floats, board_mm: Floats, reach_mm: float = 0.0) -> Ints:
    """Return for each board point (k, 2), mm, the number of the smallest component within reach, or −1."""
    parts = plane.components.widened(reach_mm) if reach_mm else plane.components
    return parts.find(np.asarray(np.linalg.inv(plane.matrix(c)), np.float64), board_mm)


def landmarks(plane: BoardPlane) -> tuple[tuple[str, ...], Floats]:
    """Return names and CAD coordinates (n, 2) of the points whose views are computed."""
    parts = plane.components
    if parts.addresses:
        return parts.addresses, parts.center
    return ("low corner", "high corner"), np.array(plane.board_type.extent())
