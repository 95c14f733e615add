"""The common shift of components, measured on a drawn board whose C is exact or wrong."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from tests.hostile.drawing import draw
from tests.hostile.filming import film
from tests.hostile.judging import stitched
from vaoi_station.geometry import apply
from vaoi_station.model import BoardType, Status
from vaoi_station.stitching.adjustment.motion import nominal_motion
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.components.centres import ComponentShift, central_views, measure_component_shift
from vaoi_station.stitching.geometry import FootprintViews
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene

C = np.array([[1.0, 0, -15.0], [0, 1, -10.0], [0, 0, 1]])
WRONG = np.array([[1 - 0.15 / 25, 0, -0.08], [0, 1 - 0.15 / 25, -0.05], [0, 0, 1]])
"""As with two fiducials, 25 mm apart, one of which is off by 0.15 mm along their line."""
STILL = nominal_motion(np.array([0.0]), np.zeros(2), np.zeros(2))


def board(count: int, body_height: float | None = None, *, apart: bool = False) -> BoardType:
    """Return a board whose components are turned by 0° and 90° in turns; `apart`, the turned ones on one half."""
    places = [(3 + 4.9 * (n % 6), 3 + 4.6 * (n // 6)) for n in range(count)]
    parts = [
        {
            "ref": f"R{n}",
            "center": [x, y],
            "width": 2.0,
            "height": 1.2,
            "rotation": 90.0 * (n % 6 // 3 if apart else n % 2),
            "body_height": body_height,
        }
        for n, (x, y) in enumerate(places)
    ]
    return BoardType.model_validate({"name": "b", "y_axis": "down", "outline": [[0, 0], [30, 20]], "components": parts})


def measured(
    workshop: Any,
    count: int = 18,
    wrong: Any = None,
    *,
    distance_mm: float | None = None,
    leaning_mm: float = 0.0,
    body_height: float | None = None,
    turned_off_mm: float = 0.0,
) -> ComponentShift | None:
    """Draw the board where C puts it, and measure its components at the places of a wrong C.

    Args:
        workshop: builders of scenes.
        count: number of components.
        wrong: (3, 3) what is wrong in C; None for nothing.
        distance_mm: working distance of the camera.
        leaning_mm: height at which the components are seen.
        body_height: height of the components that the board type states.
        turned_off_mm: how far the components that are turned by 90°, all on one half of the board, look off along y.
    """
    board_type = board(count, body_height, apart=turned_off_mm != 0)
    camera = workshop.camera((0.0, 0.0), size_px=(480, 320), px_per_mm=15.0, distance_mm=distance_mm)
    y, x = np.mgrid[:320, :480].astype(float)
    cad = apply(np.linalg.inv(C), camera.ground(np.stack([x, y], -1).reshape(-1, 2))).reshape(320, 480, 2)
    levels = 70 + 10 * np.sin(3 * cad[..., 0] + cad[..., 1])
    for part in board_type.components:
        place = apply(C, np.array([part.center]))
        seen = camera.ground(camera.project(place, np.full(1, leaning_mm)))
        off = (0.0, turned_off_mm if part.rotation == 90 else 0.0)
        local = np.abs(cad - part.center - off - (seen - place)[0])
        local = local[..., ::-1] if part.rotation == 90 else local
        levels[(local <= (1.0, 0.6)).all(-1)] = 190.0
        levels[(local <= (0.6, 0.5)).all(-1)] = 35.0
    picture = cv2.GaussianBlur(levels, (0, 0), 0.8) + np.random.default_rng(0).normal(0, 2, levels.shape)
    frame = PreparedFrame(workshop.digitised(picture))
    matrix = C if wrong is None else wrong @ C
    plane = BoardPlane(board_type, mirrored=False)
    views = FootprintViews.of(plane.components.center, matrix, (camera,), np.eye(3)[None], None)
    scene = Scene((camera,), ((0, 0),), lambda key: frame)
    parts = central_views(plane, matrix, scene, STILL, views)
    return measure_component_shift(plane, matrix, scene, STILL, parts)


def test_components_in_their_places_show_no_shift(workshop: Any) -> None:
    found = measured(workshop)
    assert found is not None
    assert found.components >= 12
    assert found.measured == pytest.approx(np.zeros(4), abs=0.01)
    assert not found.contradicts


def test_a_wrong_cad_matrix_is_measured(workshop: Any) -> None:
    found = measured(workshop, wrong=WRONG)
    assert found is not None
    assert found.contradicts
    ends = apply(C, np.array([[3.0, 3.0], [27.0, 17.0]]))
    assert found.at(apply(WRONG, ends)) == pytest.approx(ends - apply(WRONG, ends), abs=0.02)


@pytest.mark.parametrize("body_height", [None, 1.5])
@pytest.mark.parametrize("leaning_mm", [0.75, 1.5])
def test_components_that_lean_under_one_camera_are_no_contradiction(
    workshop: Any, leaning_mm: float, body_height: float | None
) -> None:
    """Components of 1.5 mm lean by up to 0.13 mm, as far as a stretch of 1 %."""
    found = measured(workshop, distance_mm=150.0, leaning_mm=leaning_mm, body_height=body_height)
    assert found is not None
    assert found.components >= 12
    assert not found.contradicts
    assert found.measured[:3] == pytest.approx(np.zeros(3), abs=0.03)


def test_a_wrong_cad_matrix_is_measured_if_stated_heights_do_not_explain_it(workshop: Any) -> None:
    found = measured(workshop, wrong=WRONG, distance_mm=300.0, leaning_mm=0.2, body_height=0.35)
    assert found is not None
    assert found.contradicts
    unknown = measured(workshop, wrong=WRONG, distance_mm=300.0, leaning_mm=0.2)
    assert unknown is not None
    assert unknown.covariance[3, 3] > 4 * found.covariance[3, 3]


@pytest.mark.parametrize("turned_off_mm", [-0.06, 0.04, 0.06])
def test_an_offset_of_one_kind_of_components_is_no_contradiction(workshop: Any, turned_off_mm: float) -> None:
    """Nine of 18 components look off alike; taken as independent, they would show a board that is turned."""
    found = measured(workshop, turned_off_mm=turned_off_mm)
    assert found is not None
    assert found.components >= 12
    assert not found.contradicts


def test_single_kinds_that_look_far_off_are_no_contradiction() -> None:
    """Two of 28 components, at one end of the board, are seen 0.1 mm off, and looked like a turn and a stretch."""
    stitch, findings = stitched(film(draw(93216)))
    assert findings.component_shift is not None
    assert not findings.component_shift.contradicts
    assert stitch.status is Status.OK


def test_few_components_show_a_large_error_only(workshop: Any) -> None:
    assert measured(workshop, count=5) is None
    few, many = measured(workshop, count=7), measured(workshop)
    assert few is not None
    assert many is not None
    assert not few.contradicts
    assert (few.by_centres.diagonal() > 1.5 * many.by_centres.diagonal()).all()
