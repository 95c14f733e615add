"""The passages of boards through the barrier."""

from __future__ import annotations

from dataclasses import replace

import pytest

from vaoi_station.acquisition.clocks import ClockModel, ClockReading
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierClear,
    BarrierClearAfterRun,
    BeltPacing,
    BoardTooSoon,
    PulseFired,
    TriggerPlan,
)
from vaoi_station.acquisition.process.messages import BoardMissed
from vaoi_station.acquisition.process.passages import (
    STILL_S,
    UNREPORTED_S,
    Passages,
    PassageWatch,
)

AHEAD_S = 1000.0
"""The host's time minus the controller's."""


@pytest.fixture
def passages() -> Passages:
    clock = ClockModel("controller")
    clock.add(ClockReading(0.0, AHEAD_S, 1e-5))
    return Passages(clock)


def test_a_second_end_extends_the_interruption_because_its_beginning_was_lost(passages: Passages) -> None:
    for event in (BarrierClear(0, 1.0), BarrierBlocked(1, 2.0), BarrierClear(2, 3.0), BarrierClear(3, 5.0)):
        passages.add(event, AHEAD_S + 9.0)
    assert passages.interruptions == [(2.0, 5.0)]


def test_a_board_without_a_run_is_missed_once(passages: Passages) -> None:
    stood = passages.add(BarrierClearAfterRun(0, 1.0), AHEAD_S + 1.1)
    assert stood == BoardMissed(AHEAD_S + 1.0, "it stood in the barrier when the line was armed")
    soon = passages.add(BoardTooSoon(1, 2.0, 0.25), AHEAD_S + 2.1)
    assert soon == BoardMissed(AHEAD_S + 2.0, "it came 0.250 s after the one before had left")
    assert passages.add(BarrierClearAfterRun(2, 2.5), AHEAD_S + 2.6) is None


BY_TIME = TriggerPlan(start_delay_s=0.2, period_s=0.1, tail_s=0.2, max_rows=9, debounce_s=0.005)
BY_BELT = replace(BY_TIME, belt=BeltPacing(20.0, 400, 200, 400, 0.08))


@pytest.fixture
def watch() -> PassageWatch:
    armed = PassageWatch()
    armed.arm(BY_BELT, False)
    return armed


def test_a_belt_that_spaces_the_rows_has_stopped_if_none_comes(watch: PassageWatch) -> None:
    watch.add(BarrierBlocked(0, 1.0), 1.0)
    assert not watch.belt_stopped(1.0 + STILL_S)
    assert watch.belt_stopped(1.1 + STILL_S)
    watch.add(PulseFired(1, 6.2, 0), 6.2)
    assert not watch.belt_stopped(6.3)
    watch.arm(replace(BY_BELT, start_delay_s=2.0), None)
    assert not watch.belt_stopped(6.2 + 8.0), "a slow belt needs 8 s to the first row"
    watch.arm(BY_TIME, None)
    assert not watch.belt_stopped(99.0)


def shown(watch: PassageWatch) -> tuple[bool, bool]:
    """Return whether a board stands in the barrier, and whether one passes."""
    return watch.standing, watch.passing


def test_a_board_that_is_in_the_barrier_when_the_line_is_armed_stands_until_it_left(watch: PassageWatch) -> None:
    watch.arm(BY_TIME, True)
    assert shown(watch) == (True, False)
    watch.check_level(True, 1.0)
    assert shown(watch)[0]
    assert watch.add(BarrierClearAfterRun(0, 2.0), 2.0)
    assert not shown(watch)[0]
    watch.arm(BY_TIME, True)
    watch.check_level(False, 3.0)
    assert not shown(watch)[0], "no edge is reported of a level that did not last for the debounce"
    watch.arm(BY_TIME, True)
    assert watch.add(BarrierBlocked(1, 4.0), 4.0)
    assert shown(watch) == (False, True), "it came just when the line was armed"
    watch.arm(BY_TIME, True)
    assert not shown(watch)[0], "the same plan again while it passes"
    watch.disarm()
    watch.check_level(True, 9.0)
    assert not shown(watch)[0]


def test_a_board_whose_edge_is_not_reported_stands_once_it_is_clear_that_none_will_come(watch: PassageWatch) -> None:
    """The controller was reset and armed again while the board was in the barrier."""
    watch.check_level(True, 10.0)
    watch.check_level(True, 10.0 + UNREPORTED_S)
    assert not shown(watch)[0], "the report of its edge may be under way"
    watch.check_level(True, 10.1 + UNREPORTED_S)
    assert shown(watch)[0]
    watch.check_level(None, 12.0)
    assert watch.standing, "the controller does not reply"
    watch.check_level(False, 13.0)
    assert not shown(watch)[0]
