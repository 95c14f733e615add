"""The plane of a board type: flat coordinates, C as a matrix, handedness, the expected direction."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from vaoi_station.model import BoardType
from vaoi_station.stitching.board.board_plane import board_plane, typical_camera


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
