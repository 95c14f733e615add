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


ENCODER: dict[str, Any] = {**VALID, "pacing": "encoder", "encoder": {"counts_per_mm": 20.0}}


def test_the_encoder_counts_the_distances_of_the_nominal_speed() -> None:
    line = Line(**ENCODER)
    assert [line.counts(s) for s in (line.start_delay_s, line.trigger_period_s, line.tail_s)] == [200, 200, 400]
    assert line.fastest_mm_s == 125.0
    assert line.shortest_period_s == pytest.approx(0.08)
    assert line.row_ways_mm(3) == (0.0, 10.0, 20.0)
    clocked = Line(**VALID, encoder={"counts_per_mm": 20.0})
    assert (clocked.fastest_mm_s, clocked.shortest_period_s, clocked.row_ways_mm(3)) == (100.0, 0.1, None)


def test_the_distance_of_the_rows_may_replace_the_period() -> None:
    given = {key: value for key, value in ENCODER.items() if key != "trigger_period_s"}
    line = Line(**given | {"encoder": {"counts_per_mm": 20.0, "row_mm": 8.0}})
    assert (line.trigger_period_s, line.counts(line.trigger_period_s)) == (0.08, 160)
    with pytest.raises(ValidationError, match=r"trigger_period_s is 0\.1, but encoder\.row_mm 8\.0 is 0\.08 s at 100 "):
        Line(**ENCODER | {"encoder": {"counts_per_mm": 20.0, "row_mm": 8.0}})
    with pytest.raises(ValidationError, match="trigger_period_s"):
        Line(**given)
    with pytest.raises(ValidationError, match="conveyor_mm_s"):
        Line(**given | {"conveyor_mm_s": "fast", "encoder": {"counts_per_mm": 20.0, "row_mm": 8.0}})


@pytest.mark.parametrize(
    ("encoder", "words"),
    [
        (None, r'pacing is "encoder", but there is no table \[line\.encoder\]'),
        ({"counts_per_mm": 0.04}, r"rows lie 10 mm, 0\.4 counts, apart, but must be 1 … 1073741824"),
        ({"counts_per_mm": 1e9}, r"rows lie 10 mm, 1e\+10 counts, apart, but must be 1 … 1073741824"),
        ({"counts_per_mm": 100.0}, r"12500 counts/s at 125 mm/s, but must be at most 12000 counts/s"),
        ({"counts_per_mm": 20.0, "fastest_mm_s": 90.0}, r"fastest_mm_s is 90, but must be at least the speed .* 100"),
    ],
)
def test_an_encoder_that_cannot_space_the_rows_is_refused(encoder: dict[str, float] | None, words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        Line(**VALID, pacing="encoder", encoder=encoder)
