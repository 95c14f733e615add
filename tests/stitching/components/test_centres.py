"""A board whose components contradict its fiducials has a reason that names them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.stitching.quality.test_agreement import PLANE, points
from tests.stitching.quality.test_agreement import C as SIMILARITY
from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, ReasonCode
from vaoi_station.stitching.adjustment.motion import nominal_motion
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.components.centres import (
    ComponentShift,
    central_views,
    centre_of_symmetry,
    component_reasons,
    likely_errors,
    measure_component_shift,
)
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene

PX_PER_MM = 16.0
HALF = np.array([20.0, 9.0])
"""Half the extent of a chip's footprint, px."""


def picture(x: float, y: float, scale: float = 1.0, noise: float = 2.0) -> NDArray[np.uint8]:
    """Draw a chip with two pads about (x, y), beside a trace and a dot that are not symmetric to it."""
    fine, shape = 8, (160, 200)
    v, u = (np.mgrid[: shape[0] * fine, : shape[1] * fine] + 0.5) / fine - 0.5
    levels = np.full(u.shape, 70.0)
    levels[(np.abs(u - x + v - y - 34) < 2) | (np.hypot(u - x + 12, v - y + 14) < 3)] = 120.0
    levels[(np.abs(u - x) < 20 * scale) & (np.abs(v - y) < 9 * scale)] = 200.0
    levels[(np.abs(u - x) < 12 * scale) & (np.abs(v - y) < 8 * scale)] = 30.0
    small = cv2.GaussianBlur(cv2.resize(levels, shape[::-1], interpolation=cv2.INTER_AREA), (0, 0), 0.8)
    noisy = small + np.random.default_rng(3).normal(0, noise, shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), np.uint8)


def test_a_chip_is_found_to_a_tenth_of_a_pixel() -> None:
    place, (x, y) = np.array([99.7, 80.4]), (101.3, 79.2)
    off = centre_of_symmetry(picture(x, y), place, HALF, PX_PER_MM)
    assert off is not None
    assert np.array(off) + place == pytest.approx((x, y), abs=0.15)


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

    They are seen at a height of `leaning_mm`, those that are turned by 90°, on one half, `turned_off_mm` off along y.
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
    views = FrameIndex((camera,), np.eye(3)[None], tester_from_cad=matrix).views(plane.components.center)
    scene = Scene((camera,), ((0, 0),), lambda key: frame)
    parts = central_views(plane, matrix, scene, STILL, views)
    return measure_component_shift(plane, matrix, scene, STILL, parts)


def test_a_wrong_cad_matrix_is_measured(workshop: Any) -> None:
    found = measured(workshop, wrong=WRONG)
    assert found is not None
    assert found.contradicts
    ends = apply(C, np.array([[3.0, 3.0], [27.0, 17.0]]))
    assert found.at(apply(WRONG, ends)) == pytest.approx(ends - apply(WRONG, ends), abs=0.02)


@pytest.mark.parametrize("body_height", [None, 1.5])
def test_components_that_lean_under_one_camera_are_no_contradiction(workshop: Any, body_height: float | None) -> None:
    """Components of 1.5 mm lean by up to 0.13 mm, as far as a stretch of 1 %."""
    found = measured(workshop, distance_mm=150.0, leaning_mm=1.5, body_height=body_height)
    assert found is not None
    assert found.components >= 12
    assert not found.contradicts
    assert found.measured[:3] == pytest.approx(np.zeros(3), abs=0.03)


@pytest.mark.parametrize("turned_off_mm", [-0.06, 0.06])
def test_an_offset_of_one_kind_of_components_is_no_contradiction(workshop: Any, turned_off_mm: float) -> None:
    """Nine of 18 components look off alike; taken as independent, they would show a board that is turned."""
    found = measured(workshop, turned_off_mm=turned_off_mm)
    assert found is not None
    assert found.components >= 12
    assert not found.contradicts


FIDUCIALS = np.array([[-12.0, -7.0], [13.0, 6.0]])
NONE = ComponentShift(np.zeros(4), np.diag([0.006, 0.005, 0.005, 0.006]) ** 2, np.array([4.0, -1.0]), 9.0, 20)


def shown(which: int, error_mm: Floats) -> ComponentShift:
    """Return what components show if this fiducial is off by an error, and the other is right."""
    wrong, right = FIDUCIALS[which], FIDUCIALS[1 - which]
    places = np.random.default_rng(2).normal(0, 9, (40, 2))
    # the similarity that leaves `right` in place and moves `wrong` by the error
    slope = complex(*error_mm) / complex(*(wrong - right))
    moved = slope * ((places - right) @ (1, 1j))
    each = [replace(NONE, measured=unit).at(places).ravel() for unit in np.eye(4)]
    unknowns = np.linalg.lstsq(np.array(each).T, np.column_stack([moved.real, moved.imag]).ravel(), rcond=None)[0]
    return replace(NONE, measured=unknowns)


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("angle", [0.0, 2.0])
def test_an_error_that_is_no_contradiction_by_itself_is_found(which: int, angle: float) -> None:
    shift = shown(which, 0.07 * np.array([np.cos(angle), np.sin(angle)]))
    assert not shift.contradicts
    first, *others = likely_errors(shift, FIDUCIALS)
    assert first.which == which
    assert first.mm == pytest.approx(0.07, rel=1e-3)
    assert all(other.chi2 < first.chi2 for other in others)


SMALL = np.diag([0.003, 0.003, 0.003, 0.003]) ** 2
AT = PLANE.matrix(SIMILARITY)
SOUND = ComponentShift(np.array([0.01, -0.01, 0.0, 0.004]), SMALL, np.zeros(2), 12.0, 20)


def test_components_that_lie_elsewhere_than_the_fiducials_put_them_are_a_reason() -> None:
    assert component_reasons(None, PLANE, AT, points(2), 10.0) == []
    assert component_reasons(SOUND, PLANE, AT, points(2), 10.0) == []
    wrong = replace(SOUND, measured=np.array([0.06, -0.02, 0.0, 0.03]))
    ((code, text),) = ((r.code, r.message) for r in component_reasons(wrong, PLANE, AT, points(2), 10.0))
    assert code == ReasonCode.COMPONENTS_SHIFTED
    assert "20 components are centred (+0.060, -0.020) mm ± (0.012, 0.012)" in text
    assert "px) at fiducial F" in text


def test_of_two_fiducials_the_one_whose_error_explains_the_components_is_named() -> None:
    """F1, 36 mm from F0, is off by 0.07 mm across their line: no check but this one sees it."""
    turned = replace(SOUND, measured=np.array([-0.001, 0.035, 0.024, 0.0]))
    assert not turned.contradicts
    ((code, text),) = ((r.code, r.message) for r in component_reasons(turned, PLANE, AT, points(2), 10.0))
    assert code == ReasonCode.COMPONENTS_SHIFTED
    assert "as if one of the two fiducials were not at its CAD position: F1 by 0.07 mm (0.7 px)" in text
    assert component_reasons(turned, PLANE, AT, points(3), 10.0) == [], "a third fiducial is redundant"
    assert component_reasons(turned, PLANE, AT, points(2), 4.0) == [], "0.28 px, which other checks accept"
