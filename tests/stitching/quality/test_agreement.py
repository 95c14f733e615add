"""A wrong diameter of the fiducials in the board type is named, instead of their places."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.stitching.quality.test_findings import findings_of
from vaoi_station.geometry import apply
from vaoi_station.model import BoardType, ReasonCode, Status
from vaoi_station.stitching.adjustment.motion import Motion, nominal_motion
from vaoi_station.stitching.adjustment.problem import (
    REFERENCE,
    AdjustmentResult,
    FiducialPoints,
    Observations,
    Problem,
    to_observations,
)
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.quality.agreement import (
    fiducial_reasons,
    reference_reasons,
)
from vaoi_station.stitching.quality.seams import seam_px
from vaoi_station.stitching.quality.verdict import judge_result


def moved(filmed: Any, which: int, off_mm: tuple[float, float]) -> BoardType:
    """The board type with a fiducial beside its place."""
    data = filmed.board_type.model_dump(mode="json", exclude_none=True)
    data["fiducials"][which]["x"] += off_mm[0]
    data["fiducials"][which]["y"] += off_mm[1]
    return BoardType.model_validate(data)


@pytest.mark.parametrize(("which", "off_mm"), [(0, (0.0, 0.05)), (1, (-0.035, -0.035))])
def test_an_error_of_which_little_is_left_in_the_residuals_is_a_reason(
    filmed: Any, which: int, off_mm: tuple[float, float]
) -> None:
    """No fiducial lies 0.3 px from its place, and scale and surface are likely: positions were wrong, and `ok`."""
    result = filmed.stitched(board_type=moved(filmed, which, off_mm))
    assert result.status is Status.DEGRADED
    text, uncertain = result.reasons
    assert "without one of the marks that place the board" in uncertain, "whichever of them it is"
    assert text.startswith("the fiducials do not fit together: FID")
    assert f"FID{which + 1} by 0.05 mm" in text
    assert filmed.error_px(result) > 0.5


MARKS = [(2.0, 2.0), (38.0, 3.0), (20.0, 18.0), (3.0, 17.0)]
BOARD = BoardType.model_validate(
    {
        "name": "b",
        "y_axis": "down",
        "outline": [[0, 0], [40, 20]],
        "fiducials": [{"name": f"F{k}", "x": x, "y": y, "diameter": 1.0} for k, (x, y) in enumerate(MARKS)],
    }
)
PLANE = BoardPlane(BOARD, mirrored=False)
STILL: Motion = nominal_motion(np.array([0.0]), np.zeros(2), np.zeros(2))
C = np.array([1.0, 0.0, -20.0, -10.0])
NO_PROBLEM = Problem(np.zeros(1), np.zeros(2), to_observations([], ()), np.zeros(0, dtype=np.int_))


def points(count: int = 4, sigma_px: float = 0.02) -> FiducialPoints:
    """Detect the first fiducials once each, exactly where the CAD data put them."""
    flat, which = PLANE.fiducials[:count], np.arange(count)
    row, none = np.zeros(count, dtype=np.int_), np.zeros((count, 2))
    ground = apply(PLANE.matrix(C), flat)
    return FiducialPoints(row, ground, none, flat, np.full(count, sigma_px / 10), np.full(count, 10.0), which, which)


def adjusted(count: int = 4, scale: float = 1.0, surface: tuple[float, ...] = ()) -> AdjustmentResult:
    none, pairs = np.zeros(0), np.zeros((0, 2))
    c = C * (scale, scale, 1, 1)
    return AdjustmentResult(
        STILL,
        c,
        np.array(surface),
        np.zeros((2, 0)),
        np.zeros((1, 7, 7)),
        none,
        pairs,
        none,
        np.zeros((count, 2)),
        0.01,
        1.0,
        NO_PROBLEM,
    )


def texts(*inputs: Any) -> list[str]:
    return [reason.message for reason in fiducial_reasons(*inputs)]


@pytest.mark.parametrize("wrong", [0, 3])
def test_the_wrong_fiducial_of_four_is_named(wrong: int) -> None:
    seen, residual = points(), np.zeros((4, 2))
    seen.ground_mm[wrong] += (0.2, -0.1)
    residual[wrong] = (0.8, -0.4)
    reasons = texts(PLANE, replace(adjusted(), fiducial_px=residual), seen, STILL, 10.0)
    assert reasons[0] == f"fiducial F{wrong} lies 0.89 px from its place (limit 0.3)"
    assert reasons[1].startswith(f"without fiducial F{wrong} the others agree: F{wrong} lies 0.22 mm (2.2 px)")


@pytest.mark.parametrize(("term", "text"), [(1, "tilt along x"), (4, "twist")])
def test_a_surface_that_no_board_has_is_a_reason(term: int, text: str) -> None:
    surface = [0.0] * 6
    surface[term] = -2.0
    (reason,) = texts(PLANE, adjusted(2, surface=tuple(surface)), points(2), STILL, 10.0)
    assert f"the board has a {text} of -2.00 mm" in reason


def test_a_surface_of_which_only_the_sum_is_unlikely_is_a_reason() -> None:
    """An error of one of three fiducials leaves no residual, and makes a little of each coefficient."""
    likely = (0.8, 0.16, -0.16, 0.5, 0.2, 0.5)
    assert texts(PLANE, adjusted(3, surface=likely), points(3), STILL, 10.0) == []
    ((code, text),) = (
        (r.code, r.message)
        for r in fiducial_reasons(PLANE, adjusted(3, surface=(0.8, 0.27, -0.3, 0.03, 0.39, 0.7)), points(3), STILL, 10)
    )
    assert code == ReasonCode.SURFACE_UNLIKELY
    assert (
        "tilted and bent at once (6.8 standard deviations together, limit 5.6; most of it by a twist of +0.39 mm)"
        in text
    )


def referred(off_px: tuple[float, float], count: int = 30) -> tuple[FiducialPoints, np.ndarray]:
    """Two fiducials without residuals, and points of a reference that lie `off_px` away, with scatter."""
    two, g = points(2), np.random.default_rng(2)
    many = FiducialPoints.joined([points(1)] * count)
    seen = FiducialPoints.joined([two, replace(many, which=np.full(count, REFERENCE))])
    return seen, np.concatenate([np.zeros((2, 2)), g.normal(0, 0.03, (count, 2)) + off_px])


def test_a_reference_that_contradicts_the_fiducials_is_a_reason() -> None:
    ((code, text),) = ((r.code, r.message) for r in reference_reasons(*referred((0.5, 4.3))))
    assert code == ReasonCode.REFERENCE_CONTRADICTS
    assert text.startswith("only 0 of 30 points of the reference lie where the fiducials put them (limit 50%)")
    assert "4.3" in text


def test_a_reference_that_agrees_or_has_only_false_links_is_no_reason() -> None:
    assert reference_reasons(*referred((0.0, 0.02))) == []
    assert reference_reasons(*referred((0.5, 4.3), count=10)) == []
    seen, off = referred((0.0, 0.0))
    false_links = np.random.default_rng(5).uniform(-20, 20, off.shape)
    assert reference_reasons(seen, false_links) == []
    assert reference_reasons(replace(seen, which=np.full(len(off), REFERENCE)), off + 4) == []


def test_a_seam_of_components_whose_links_were_rejected_shows_the_offset_across_their_lean() -> None:
    """A camera tilted by 1.7 px beside components only: its links were outliers, and the run was ok and 1.1 px off."""
    row, pairs, lean = np.zeros(13, dtype=np.int_), np.zeros((13, 2)), np.tile((0.1, 0.0), (13, 1))
    noise, resolution, overlap = np.zeros((13, 2, 2)), np.full(13, 10.0), np.ones(13)
    links = Observations(*(row,) * 5, pairs, pairs, pairs, lean, noise, resolution, overlap, ())
    problem, at = replace(NO_PROBLEM, links=links, component=np.full(13, 3)), np.arange(13)
    apart = replace(adjusted(), link_px=np.tile((-1.1, -1.7), (13, 1)), weight=np.where(at < 2, 1.0, 0.0))
    assert seam_px(problem, apart, at, 12) == pytest.approx(1.7)
    assert seam_px(problem, replace(apart, weight=np.ones(13)), at, 12) is None, "links that fit"
    assert seam_px(problem, apart, at[:5], 12) is None, "too few"
    heights = replace(apart, link_px=np.tile((-1.1, 0.02), (13, 1)))
    assert seam_px(problem, heights, at, 12) is None, "tall components"
    bare = replace(problem, component=np.full(13, -1))
    assert seam_px(bare, apart, at, 12) == pytest.approx(np.hypot(1.1, 1.7))


def resized(board_type: BoardType, diameter: float) -> BoardType:
    marks = [mark.model_dump() | {"diameter": diameter} for mark in board_type.fiducials]
    return BoardType.model_validate(board_type.model_dump(mode="json", exclude_none=True) | {"fiducials": marks})


@pytest.mark.parametrize("stated", [0.7, 2.0])
def test_marks_of_another_size_at_the_right_places_are_named(filmed: Any, stated: float) -> None:
    board_type = resized(filmed.board_type, stated)
    status, reasons = judge_result(findings_of(filmed, board_type=board_type))
    assert status is Status.FAILED
    assert reasons[0].code == "fiducial-size"
    assert f"are where fiducials of {stated:.2g} mm are expected: correct the diameter" in reasons[0].message
    found = float(reasons[0].message.split("marks of about ")[1].split(" mm")[0])
    assert found == pytest.approx(1.0, rel=0.1)
    assert "fiducials-not-found" in [reason.code for reason in reasons]
