"""Tests of the table `line`: what follows from speed and lengths, and limits in the wrong order."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from vaoi_station.line_config import Line

VALID: dict[str, Any] = {
    "conveyor_mm_s": (0.0, 100.0), "barrier_mm": 0.0, "start_delay_s": 0.1,
    "trigger_period_s": 0.1, "tail_s": 0.2, "longest_board_mm": 50.0,
}  # fmt: skip


def test_rows_cover_the_longest_board_and_the_tail() -> None:
    line = Line(**VALID)
    assert line.speed_mm_s == 100.0
    assert line.passing_s == pytest.approx(0.7)
    assert line.rows_of_longest_board == 7


@pytest.mark.parametrize("key", ["speed_limits_mm_s", "rail_limits_mm"])
def test_limits_begin_with_the_lower_one(key: str) -> None:
    with pytest.raises(ValidationError, match=f"{key} is .200.0, 100.0., but must begin with the lower limit"):
        Line(**VALID, **{key: (200.0, 100.0)})
