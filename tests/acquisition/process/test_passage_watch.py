"""A board counts as passing from the edge of the barrier to the end of its run, and while it is in the barrier."""

from __future__ import annotations

from dataclasses import replace

import pytest

from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierClear,
    BarrierClearAfterRun,
    BeltPacing,
    BoardTooSoon,
    PulseFired,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.process.passages import STILL_S, UNREPORTED_S, PassageWatch

BY_TIME = TriggerPlan(start_delay_s=0.2, period_s=0.1, tail_s=0.2, max_rows=9, debounce_s=0.005)
BY_BELT = replace(BY_TIME, belt=BeltPacing(20.0, 400, 200, 400, 0.08))


@pytest.fixture
def watch() -> PassageWatch:
    armed = PassageWatch()
    armed.arm(BY_BELT, False)
    return armed


def test_a_board_passes_from_the_edge_to_the_end_of_its_run(watch: PassageWatch) -> None:
    events = [BarrierBlocked(0, 1.0), PulseFired(1, 1.2, 0), BarrierClear(2, 1.3), RunEnded(3, 1.5, 1, "clear")]
    assert [(watch.add(event, event.time_s), watch.passing) for event in events] == [
        (True, True), (False, True), (False, True), (True, False),
    ]  # fmt: skip


def test_a_replay_that_reports_no_clear_barrier_leaves_none_blocked(watch: PassageWatch) -> None:
    watch.add(BarrierBlocked(0, 1.0), 1.0)
    assert watch.add(RunEnded(1, 1.5, 1, "clear"), 1.5)
    assert not watch.passing


def test_a_board_that_stays_after_its_rows_is_in_the_barrier_until_it_left(watch: PassageWatch) -> None:
    watch.add(BarrierBlocked(0, 1.0), 1.0)
    assert not watch.add(RunEnded(1, 1.5, 9, "max-rows"), 1.5)
    assert not watch.belt_stopped(99.0), "without a run no row is awaited"
    assert watch.add(BarrierClearAfterRun(2, 2.0), 2.0)


def test_a_board_that_came_too_soon_is_in_the_barrier_until_it_left_or_its_edge_was_lost(watch: PassageWatch) -> None:
    assert watch.add(BoardTooSoon(0, 1.0, 0.1), 1.0)
    watch.forget_barrier()
    assert not watch.passing
    watch.add(BarrierBlocked(0, 1.0), 1.0)
    watch.forget_barrier()
    assert watch.passing, "the end of a run is always reported"


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


def test_while_disarmed_nothing_passes(watch: PassageWatch) -> None:
    watch.add(BarrierBlocked(0, 1.0), 1.0)
    watch.disarm()
    assert not watch.passing
    assert not watch.add(PulseFired(1, 2.0, 0), 2.0), "a single pulse is no board"


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


def test_a_board_whose_run_was_cut_short_is_in_the_barrier_until_that_is_clear(watch: PassageWatch) -> None:
    watch.add(BarrierBlocked(0, 1.0), 1.0)
    watch.add(RunEnded(1, 1.5, 3, "the controller was reset"), 1.5)
    assert (watch.passing, watch.standing) == (True, False)
    watch.check_level(False, 1.9)
    assert not shown(watch)[1]
