"""The trigger plan of a line, and what an event carries."""

from __future__ import annotations

from vaoi_station.acquisition.controller.interface import (
    TriggerPlan,
)
from vaoi_station.line_config import Line

LINE = Line(
    conveyor_mm_s=(0.0, 100.0),
    barrier_mm=-40.0,
    start_delay_s=0.3,
    trigger_period_s=0.125,
    tail_s=0.4,
    longest_board_mm=60.0,
    debounce_s=0.004,
)


def test_a_slow_or_long_board_may_leave_after_a_disarm() -> None:
    assert TriggerPlan.of(LINE).grace_s == 8.0
    # 474 mm at 50 mm/s pass in 9.5 s.
    slow = LINE.model_copy(update={"conveyor_mm_s": (0.0, 50.0), "longest_board_mm": 474.0})
    assert 1.25 * slow.passing_s <= TriggerPlan.of(slow).grace_s < 1.4 * slow.passing_s


def test_the_longest_board_limits_the_rows() -> None:
    """60 mm pass in 0.6 s and the tail adds 0.4 s: pulses at 0.3, 0.425, … 0.925 s."""
    plan = TriggerPlan.of(LINE)
    assert plan.max_rows == LINE.rows_of_longest_board >= 6
    assert TriggerPlan.of(LINE.model_copy(update={"longest_board_mm": 600.0})).max_rows > plan.max_rows
