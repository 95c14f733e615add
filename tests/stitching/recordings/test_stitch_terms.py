"""The terms of a station give the expectation that the station had, also after their way through a file."""

from __future__ import annotations

import pytest

from vaoi_station.line_config import Line
from vaoi_station.model import BoardType
from vaoi_station.model.board_type import Visibility
from vaoi_station.stitching.expectation import StitchTerms, expectation_of


@pytest.mark.parametrize("velocity", [(0.0, 100.3), (0.0, -100.3), (77.7, 1.0)])
def test_the_expectation_is_that_of_the_station(velocity: tuple[float, float]) -> None:
    line = Line.model_validate(
        {
            "conveyor_mm_s": velocity,
            "barrier_mm": -40.1,
            "start_delay_s": 0.1,
            "trigger_period_s": 0.1,
            "tail_s": 0.2,
            "longest_board_mm": 200.0,
            "expected_board": {"center_mm": 31.3, "rotation_deg": 90, "tolerance_mm": 2.5},
        }
    )
    board_type = BoardType(name="b", unit="inch", outline=((0.0, 0.0), (4.0, 2.0)))
    terms = StitchTerms.of(line, Visibility(coverage=0.5), {"ring": (0, 1)})
    read = StitchTerms.model_validate_json(terms.model_dump_json())
    assert read == terms
    assert read.expectation(board_type) == expectation_of(line, board_type), "to the last digit"
    longer = board_type.model_copy(update={"outline": ((0.0, 0.0), (5.0, 2.0))})
    assert read.expectation(longer) == expectation_of(line, longer)
