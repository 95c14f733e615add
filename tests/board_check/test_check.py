"""A drawn board, checked with right and wrong data: the truth is exact."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.board_check.conftest import ALL, MIDDLE, drawn_board, drawn_run, moved
from vaoi_station.board_check.check import (
    ABSENT,
    FOUND,
    STATED,
    check_board,
    distances_of_marks,
    picture_of_check,
)
from vaoi_station.board_check.correction import Group, Move
from vaoi_station.board_check.overview import CheckedRun
from vaoi_station.board_check.report import BoardCheck, Unlikely
from vaoi_station.errors import InputError
from vaoi_station.model import BoardType


def codes(report: BoardCheck) -> list[str]:
    return [warning.code for warning in report.warnings]


def worst_mm(proposal: BoardType | None, truth: BoardType) -> float:
    assert proposal is not None
    pairs = zip(proposal.components, truth.components, strict=True)
    return max(math.dist(a.center, b.center) for a, b in pairs)


def test_right_data_have_no_residual(run: CheckedRun, board: BoardType) -> None:
    report = check_board(run, board)
    assert codes(report) == [], report.warnings
    assert report.proposal is None
    assert report.residual is not None
    (x, y), (sx, sy) = report.residual.shift_mm, report.residual.shift_sigma_mm
    assert abs(x) < 3 * sx < 0.06
    assert abs(y) < 3 * sy < 0.06
    assert abs(report.residual.rotation_deg) < 3 * report.residual.rotation_sigma_deg
    assert [f.off_mm is not None and f.off_mm < 0.02 for f in report.fiducials] == [True] * 3
    assert len(report.unlikely) <= 2


@pytest.mark.parametrize(
    ("move", "groups", "expected"),
    [
        (Move(False, 0, 1, MIDDLE, (1.5, -3.0)), ("components",), {"shifted"}),
        (Move(True, 90, 1, MIDDLE, (4.0, 2.0)), ALL, {"mirrored", "turned", "shifted", "fiducials-elsewhere"}),
        (Move(False, 0.6, 1.008, MIDDLE, (0, 0)), ("components",), {"turned", "scaled"}),
    ],
)
def test_wrong_data_are_corrected_to_the_truth(
    run: CheckedRun, board: BoardType, move: Move, groups: tuple[Group, ...], expected: set[str]
) -> None:
    report = check_board(run, moved(board, move, groups))
    assert expected <= set(codes(report))
    assert "components-missing" not in codes(report)
    assert report.residual is not None
    assert report.residual.mirrored == move.mirrored
    assert report.residual.scale == pytest.approx(1 / move.scale, abs=4 * report.residual.scale_sigma)
    assert worst_mm(report.proposal, board) < 0.05
    assert report.proposal is not None
    assert (report.proposal.state, report.proposal.revision) == ("draft", "B corrected")
    assert ("fiducials" in report.moved) == ("fiducials" in groups)
    off = [(a.x - b.x, a.y - b.y) for a, b in zip(report.proposal.fiducials, board.fiducials, strict=True)]
    assert np.abs(off).max() < 0.05


def test_data_of_another_board_are_not_found(run: CheckedRun) -> None:
    report = check_board(run, drawn_board(seed=9))
    assert codes(report) == ["not-found"]
    assert "another board or side" in report.warnings[0].message
    assert (report.tester_from_cad, report.proposal, report.residual) == (None, None, None)


def test_c_of_the_run_decides_if_a_layout_is_symmetric() -> None:
    """Each body has a partner on the other side of the board's middle: turned by 180°, the bodies lie the same."""
    half = drawn_board(count=16)
    mirrored = [
        part.model_copy(update={"ref": f"R{n}", "center": (50 - part.center[0], 36 - part.center[1])})
        for n, part in enumerate(half.components)
    ]
    apart = [p for p in mirrored if min(math.dist(p.center, q.center) for q in half.components) > 3.4]
    kept = [half.components[int(p.ref[1:])] for p in apart]
    board = half.model_copy(update={"components": (*kept, *apart)})
    run = drawn_run(board)
    report = check_board(run, board)
    assert report.rival_score > report.score - 1
    assert (codes(report), report.proposal) == ([], None)
    lost = replace(run, board_type=None)
    assert codes(check_board(lost, board)) == ["not-found"]


def test_too_few_components_and_a_wrong_unit_are_refused(run: CheckedRun, board: BoardType) -> None:
    with pytest.raises(InputError, match=r"2 entries.*at least 3"):
        check_board(run, board.model_copy(update={"components": board.components[:2]}))
    with pytest.raises(InputError, match="Check the unit of the data, 'inch'"):
        check_board(run, board.model_copy(update={"unit": "inch"}))


def test_a_mark_is_measured_where_it_is_and_missed_where_it_is_not(run: CheckedRun, board: BoardType) -> None:
    first, *rest = board.fiducials
    near = first.model_copy(update={"name": "near", "x": first.x + 0.1})
    bare = first.model_copy(update={"name": "bare", "x": 25.0, "y": 1.5})
    far = first.model_copy(update={"name": "far", "x": 80.0})
    changed = board.model_copy(update={"outline": None, "fiducials": (near, bare, far, *rest)})
    found = distances_of_marks(run, changed, np.array(run.stitch.cad_matrix))
    assert abs(found[0] - 0.1) < 0.01
    assert math.isnan(found[1])
    assert math.isnan(found[2])
    assert max(found[3:]) < 0.01


def test_a_mark_without_contrast_under_one_light_is_searched_under_another(run: CheckedRun, board: BoardType) -> None:
    stitch = run.stitch
    twice = {"row_motion": stitch.row_motion * 2, "image_matrices": tuple(m * 2 for m in stitch.image_matrices)}

    def frame(camera: int, row: int) -> NDArray[np.generic] | None:
        pixels = run.frame(camera, 0)
        return np.full_like(pixels, 20) if pixels is not None and row == 0 else pixels

    changed = replace(run, stitch=stitch.model_copy(update=twice), frame=frame)
    matrix = np.array(stitch.cad_matrix)
    assert all(math.isnan(distance) for distance in distances_of_marks(changed, board, matrix))
    two_lights = replace(changed, lights=("dark", "bright"))
    assert max(distances_of_marks(two_lights, board, matrix)) < 0.01


def has(picture: np.ndarray, colour: tuple[int, int, int]) -> bool:
    return bool((np.abs(picture.astype(int) - colour).sum(2) < 60).any())


def test_bodies_are_drawn_where_they_are_stated_and_found(run: CheckedRun, board: BoardType) -> None:
    found = np.array(run.stitch.cad_matrix)
    found[0, 2] += 3.0
    nothing = BoardCheck(board_type="b", score=9.0, rival_score=4.0, components=40, measured=0)
    report = nothing.model_copy(
        update={"tester_from_cad": found.tolist(), "unlikely": [Unlikely(ref="U1", share=0.1)]},
    )
    picture = picture_of_check(run, board, report)
    assert picture.ndim == 3
    assert 400 <= max(picture.shape) <= 1600
    assert [has(picture, colour) for colour in (FOUND, STATED, ABSENT)] == [True] * 3
    assert not has(picture_of_check(replace(run, board_type=None), board, report), STATED)
    assert not has(picture_of_check(run, board, nothing), FOUND)
