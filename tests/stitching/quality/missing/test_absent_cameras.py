"""Reasons for cameras without a good frame: they name the fiducials that no other camera shows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import Motion, nominal_motion
from vaoi_station.stitching.board.board_plane import BoardPlane, board_plane
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.matching.frames import Scene
from vaoi_station.stitching.quality.visibility import absent_camera_reasons, expected_fiducials

MARKS = {"LEFT": (2.0, 5.0), "MIDDLE": (18.5, 5.0), "RIGHT": (34.0, 5.0)}
PLACED = Expectation(corner_mm=(-10.0, -5.0))
MOTION: Motion = nominal_motion(np.array([0.0, 0.1]), np.array([0.0, 60.0]), np.zeros(2))


def board(unit: str = "mm") -> BoardType:
    k = {"mm": 1.0, "inch": 25.4}[unit]
    marks = [{"name": n, "x": x / k, "y": y / k, "diameter": 1.0 / k} for n, (x, y) in MARKS.items()]
    outline = [[0, 0], [36 / k, 10 / k]]
    return BoardType.model_validate(
        {"name": "b", "unit": unit, "y_axis": "down", "outline": outline, "fiducials": marks}
    )


def scene(workshop: Any, *present: tuple[int, int]) -> Scene:
    """Two cameras that show x from −10 to 10 mm and from 7 to 27 mm."""
    cameras = (workshop.camera((0, 0)), workshop.camera((17, 0)))
    return Scene(cameras, present, lambda key: pytest.fail("no pixels are needed"))


def plane(s: Scene, unit: str = "mm") -> BoardPlane:
    return board_plane(board(unit), s.cameras[0])


def texts(*inputs: Any) -> list[str]:
    return [text for _, text in absent_camera_reasons(*inputs)]


def test_cameras_with_a_frame_are_no_reason(workshop: Any) -> None:
    s = scene(workshop, (0, 0), (1, 1))
    assert absent_camera_reasons(s, plane(s), PLACED, MOTION) == []


def test_fiducials_of_the_overlap_are_not_lost(workshop: Any) -> None:
    s = scene(workshop, (0, 0))
    (reason,) = texts(s, plane(s), PLACED, MOTION)
    assert reason == (
        "camera 1 delivered no complete frame of this board, and no other camera shows the fiducial RIGHT"
    )
    left = scene(workshop, (1, 0))
    (reason,) = texts(left, plane(left), PLACED, MOTION)
    assert reason.endswith("shows the fiducial LEFT")


def test_all_cameras_absent_name_their_own_fiducials(workshop: Any) -> None:
    s = scene(workshop)
    first, second = texts(s, plane(s), PLACED, MOTION)
    assert first.endswith("the fiducials LEFT, MIDDLE")
    assert second.endswith("the fiducials MIDDLE, RIGHT")


def test_without_a_place_or_a_board_type_no_fiducial_is_named(workshop: Any) -> None:
    s = scene(workshop, (0, 0))
    assert texts(s, plane(s), Expectation(), MOTION) == [
        "camera 1 delivered no complete frame of this board: fiducials that only this camera shows cannot be found"
    ]
    assert texts(s, None, PLACED, MOTION) == ["camera 1 delivered no complete frame of this board"]


@pytest.mark.parametrize("unit", ["mm", "inch"])
def test_expected_fiducials_lie_at_the_expected_corner(workshop: Any, unit: str) -> None:
    s = scene(workshop)
    places = expected_fiducials(plane(s, unit), s, PLACED)
    assert places == pytest.approx(np.array(list(MARKS.values())) + (-10.0, -5.0))
    assert expected_fiducials(plane(s, unit), s, Expectation(corner_mm=(None, -5.0))) is None


def test_a_board_expected_upside_down_has_its_lowest_corner_there_as_well(workshop: Any) -> None:
    s = scene(workshop)
    places = expected_fiducials(plane(s), s, Expectation(angle_rad=np.pi, corner_mm=(-10.0, -5.0)))
    assert places == pytest.approx(np.array([36.0, 10.0]) - np.array(list(MARKS.values())) + (-10.0, -5.0))
