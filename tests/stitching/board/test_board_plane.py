"""The plane of a board type: flat coordinates, C as a matrix, handedness, the expected direction."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from vaoi_station.model import BoardType
from vaoi_station.stitching.board.board_plane import board_plane, expected_angle, typical_camera
from vaoi_station.stitching.expectation import Expectation


def board(y_axis: str = "up", side: str = "top") -> BoardType:
    marks = [{"name": "A", "x": 1.0, "y": 2.0, "diameter": 1.0}, {"name": "B", "x": 30.0, "y": 15.0, "diameter": 1.0}]
    outline = [[0, 0], [40, 20]]
    return BoardType.model_validate(
        {"name": "b", "y_axis": y_axis, "side": side, "outline": outline, "fiducials": marks}
    )


@pytest.mark.parametrize("y_up", [False, True])
@pytest.mark.parametrize(
    ("y_axis", "side", "mirrors"),
    [("up", "top", True), ("down", "top", False), ("up", "bottom", False), ("down", "bottom", True)],
)
def test_handedness_is_the_table_of_the_conventions(
    workshop: Any, y_axis: str, side: str, mirrors: bool, y_up: bool
) -> None:
    camera = workshop.camera(y_up=y_up)
    plane = board_plane(board(y_axis, side), camera)
    image_from_cad = camera.image_from_row.matrix @ plane.matrix(np.array([1.0, 0.0, 0.0, 0.0]))
    assert (np.linalg.det(image_from_cad) < 0) == mirrors


@pytest.mark.parametrize("side", ["top", "bottom"])
@pytest.mark.parametrize("turn", [0.0, -1.2])
@pytest.mark.parametrize("mounted", [0.0, -0.4])
def test_expected_angle_follows_side_camera_and_expectation(
    workshop: Any, side: str, turn: float, mounted: float
) -> None:
    """An image direction turned by `turn` is a tester direction turned by it, less the mounting of the camera."""
    camera = workshop.camera(angle_rad=mounted)
    found = expected_angle(board_plane(board(side=side), camera), camera, Expectation(angle_rad=turn))
    expected = turn - mounted + (math.pi if side == "bottom" else 0.0)
    assert math.cos(found - expected) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(
    ("rolls_deg", "typical"),
    [
        ((0, 0, 0), 0),
        ((180, 0, 0), 1),
        ((0, 180, 0), 0),
        ((180, 180, 180), 0),
        ((180, 0), 0),
    ],
)
def test_most_cameras_decide_what_is_upright(workshop: Any, rolls_deg: tuple[float, ...], typical: int) -> None:
    """A camera that is mounted otherwise than the rest does not see the board as it is expected."""
    cameras = [workshop.camera(angle_rad=math.radians(roll)) for roll in rolls_deg]
    assert typical_camera(cameras) is cameras[typical]


@pytest.mark.parametrize("y_up", [False, True])
@pytest.mark.parametrize("rolls_deg", [(10, -10, 10), (190, 170, 190), (100, 80)])
def test_if_all_cameras_are_rolled_the_axes_of_the_tester_are_upright(
    workshop: Any, rolls_deg: tuple[float, ...], y_up: bool
) -> None:
    cameras = [workshop.camera(angle_rad=math.radians(roll), y_up=y_up) for roll in rolls_deg]
    upright = workshop.camera(angle_rad=math.radians(round(rolls_deg[0] / 90) * 90), y_up=y_up)
    plane = board_plane(board(), upright)
    for turn in (0.0, 0.4):
        expected = expected_angle(plane, upright, Expectation(angle_rad=turn))
        found = expected_angle(plane, typical_camera(cameras), Expectation(angle_rad=turn))
        assert math.cos(found - expected) == pytest.approx(1.0, abs=1e-9)
