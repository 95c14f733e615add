"""The terms of a station give the expectation that the station had, also after their way through a file."""

from __future__ import annotations

import math
from typing import Any

import pytest

from vaoi_station.errors import InputError
from vaoi_station.line_config import Line
from vaoi_station.model import BoardType
from vaoi_station.model.board_type import Visibility
from vaoi_station.stitching.expectation import StitchTerms, expectation_of, refuse_unplaceable

BOARD = BoardType(name="b", unit="inch", outline=((0.0, 0.0), (4.0, 2.0)))
W, L = 101.6, 50.8


def line(velocity: tuple[float, float], **expected: Any) -> Line:
    return Line.model_validate(
        {
            "conveyor_mm_s": velocity,
            "barrier_mm": -40.0,
            "start_delay_s": 0.1,
            "trigger_period_s": 0.1,
            "tail_s": 0.2,
            "longest_board_mm": 200.0,
            "expected_board": expected,
        }
    )


@pytest.mark.parametrize(
    ("velocity", "rotation", "corner"),
    [
        ((0.0, 100.0), 0.0, (None, -30.0 - L)),
        ((0.0, -100.0), 0.0, (None, -50.0)),
        ((100.0, 0.0), 0.0, (-30.0 - W, None)),
        ((0.0, 100.0), 90.0, (None, -30.0 - W)),
        ((0.0, 100.0), 180.0, (None, -30.0 - L)),
    ],
)
def test_leading_edge_follows_from_barrier_and_delay(
    velocity: tuple[float, float], rotation: float, corner: tuple[float | None, float | None]
) -> None:
    found = expectation_of(line(velocity, rotation_deg=rotation), BOARD)
    assert found.corner_mm == pytest.approx(corner)
    assert found.angle_rad == pytest.approx(-math.radians(rotation))


MARKS: list[dict[str, Any]] = [{"name": f"F{n}", "x": 5.0 * n, "y": 1.0, "diameter": 1.0} for n in range(3)]


@pytest.mark.parametrize(("count", "words"), [(0, "0 fiducials"), (1, "1 fiducial,")])
def test_fewer_than_two_fiducials_are_refused(count: int, words: str) -> None:
    with pytest.raises(InputError, match=f"board.json: board type 'b' has {words}.* at least 2") as refusal:
        refuse_unplaceable(BoardType.model_validate({"name": "b", "fiducials": MARKS[:count]}), "board.json")
    assert refusal.value.code == "too-few-fiducials"
    assert "as fiducials" in refusal.value.action


@pytest.mark.parametrize("velocity", [(0.0, 100.3), (0.0, -100.3), (77.7, 1.0)])
def test_the_expectation_is_that_of_the_station(velocity: tuple[float, float]) -> None:
    known = line(velocity, center_mm=31.3, rotation_deg=90, tolerance_mm=2.5)
    terms = StitchTerms.of(known, Visibility(coverage=0.5), {"ring": (0, 1)})
    read = StitchTerms.model_validate_json(terms.model_dump_json())
    assert read == terms
    assert read.expectation(BOARD) == expectation_of(known, BOARD), "to the last digit"
    longer = BOARD.model_copy(update={"outline": ((0.0, 0.0), (5.0, 2.0))})
    assert read.expectation(longer) == expectation_of(known, longer)
