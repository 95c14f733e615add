"""What a session makes of every edge of the barrier: runs, missed boards, and the interruptions of each run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest

from tests.acquisition.process.test_session import SessionBench, session_bench
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierBlockedAgain,
    BarrierClear,
    BarrierClearAfterRun,
    BeltPacing,
    BoardTooSoon,
    PulseSkipped,
    RunEnded,
)
from vaoi_station.acquisition.process.messages import BoardMissed, Grant, MissedPassage, RunFinished, RunStarted
from vaoi_station.config import StationConfig
from vaoi_station.line_config import Encoder


@pytest.fixture
def bench(make_config: Callable[..., StationConfig]) -> Iterator[SessionBench]:
    with session_bench(make_config()) as bench:
        yield bench


def pass_two(bench: SessionBench) -> None:
    """Let a second board block the barrier within the tail of the first, and outlast the run."""
    handle = bench.session.handle_event
    handle(BarrierBlocked(0, 9.7), 9.7)
    bench.pulse(10.0, 0)
    bench.frames(10.0, 0)
    handle(BarrierClear(1, 10.05), 10.05)
    handle(BarrierBlockedAgain(2, 10.2), 10.2)
    bench.pulse(10.3, 1)
    bench.frames(10.3, 1)
    handle(RunEnded(3, 10.31, 2, "max-rows"), 10.32)
    handle(BarrierClearAfterRun(4, 10.6), 10.6)
    bench.session.tick(20.0)


def test_a_run_reports_every_interruption_of_the_barrier(bench: SessionBench) -> None:
    bench.session.grant(Grant("a", 0))
    bench.session.arm(bench.plan)
    pass_two(bench)
    (finished,) = bench.of(RunFinished)
    assert finished.interruptions == ((-0.3, 0.05), (0.2, None))
    assert not bench.of(BoardMissed), "what outlasts its run belongs to the run"


def test_a_missed_passage_reports_every_interruption(bench: SessionBench) -> None:
    bench.session.arm(bench.plan)
    bench.session.handle_event(BarrierBlocked(0, 9.7), 9.7)
    bench.pulse(10.0, 0)
    bench.session.handle_event(BarrierClear(1, 10.05), 10.05)
    bench.session.handle_event(BarrierBlockedAgain(2, 10.2), 10.2)
    bench.session.handle_event(RunEnded(3, 10.31, 2, "max-rows"), 10.32)
    assert len(bench.of(BoardMissed)) == 1
    (passage,) = bench.of(MissedPassage)
    assert passage.host_time_s == pytest.approx(9.7)
    assert [round(blocked, 6) for blocked, _ in passage.interruptions] == [0.0, 0.5]


def test_a_missed_passage_has_the_way_of_the_belt_if_there_is_an_encoder(
    make_config: Callable[..., StationConfig],
) -> None:
    """The rows need not follow the encoder."""
    config = make_config()
    line = config.line.model_copy(update={"encoder": Encoder(counts_per_mm=20.0)})
    for fitted in (line, config.line):
        with session_bench(config.model_copy(update={"line": fitted})) as bench:
            bench.session.arm(bench.plan)
            bench.session.handle_event(BarrierBlocked(0, 9.7, 500), 9.7)
            bench.pulse(10.0, 0)
            bench.session.handle_event(BarrierClear(1, 40.0, 1500), 40.0)
            bench.session.handle_event(RunEnded(2, 40.1, 1, "clear"), 40.1)
            (passage,) = bench.of(MissedPassage)
            assert passage.ways_mm == (((0.0, 50.0),) if fitted.encoder else None)


def test_a_board_that_stood_in_the_barrier_when_the_line_was_armed_is_missed(bench: SessionBench) -> None:
    bench.session.grant(Grant("a", 0))
    bench.session.arm(bench.plan)
    bench.session.handle_event(BarrierClearAfterRun(0, 5.0), 5.0)
    (missed,) = bench.of(BoardMissed)
    assert "it stood in the barrier when the line was armed" in missed.reason
    pass_two(bench)
    bench.session.finish_disarming(30.0)
    bench.session.arm(bench.plan)
    bench.session.handle_event(BarrierClearAfterRun(5, 40.0), 40.0)
    assert len(bench.of(BoardMissed)) == 2


def test_a_board_within_the_minimum_gap_is_missed_once(bench: SessionBench) -> None:
    bench.session.grant(Grant("a", 0))
    bench.session.arm(bench.plan)
    bench.session.handle_event(BoardTooSoon(0, 5.0, 0.25), 5.0)
    bench.session.handle_event(BarrierClearAfterRun(1, 5.5), 5.5)
    (missed,) = bench.of(BoardMissed)
    assert missed.reason == "it came 0.250 s after the one before had left"


def test_a_board_whose_edge_was_lost_has_no_interruptions_of_the_one_before(bench: SessionBench) -> None:
    for n in range(2):
        bench.session.grant(Grant(f"run {n}", n))
    bench.session.arm(bench.plan)
    bench.session.handle_event(BarrierBlocked(0, 9.7), 9.7)
    bench.pulse(10.0, 0)
    bench.frames(10.0, 0)
    bench.session.handle_event(RunEnded(1, 10.1, 1, "clear"), 10.1)
    bench.pulse(20.0, 0)
    bench.frames(20.0, 0)
    bench.session.handle_event(RunEnded(2, 20.1, 1, "clear"), 20.1)
    bench.session.tick(30.0)
    assert [finished.interruptions for finished in bench.of(RunFinished)] == [((-0.3, None),), ()]
    # Nor its time: a run whose edge is not known must not get the order of the board before.
    assert [(r.host_time_s, r.edge_known) for r in bench.of(RunStarted)] == [(9.7, True), (20.0, False)]


def test_the_edge_of_a_board_without_a_pulse_is_not_that_of_the_next_one(bench: SessionBench) -> None:
    bench.session.grant(Grant("a", 0))
    bench.session.arm(bench.plan)
    bench.session.handle_event(BarrierBlocked(0, 9.7), 9.7)
    bench.session.handle_event(RunEnded(1, 9.9, 0, "clear"), 9.9)
    assert len(bench.of(BoardMissed)) == 1
    # The report of the next board's edge is lost.
    bench.pulse(20.0, 0)
    assert [(r.host_time_s, r.edge_known) for r in bench.of(RunStarted)] == [(20.0, False)]


def test_a_run_on_a_fast_belt_is_described_by_what_the_belt_did(bench: SessionBench) -> None:
    """The rows come every 0.8 periods; row 1 is skipped, and the report of row 3 is lost."""
    period_s = bench.plan.period_s
    plan = replace(bench.plan, belt=BeltPacing(20.0, 40, 200, 400, 0.7 * period_s))
    bench.session.grant(Grant("a", 0))
    bench.session.arm(plan)
    bench.session.handle_event(BarrierBlocked(0, 9.7), 9.7)
    for row in (0, 1, 2, 4):
        at_s = 10.0 + 0.8 * row * period_s
        if row == 1:
            bench.session.handle_event(PulseSkipped(0, at_s, row, "too fast"), at_s)
        else:
            bench.pulse(at_s, row)
    (record,) = bench.session._recorder.open_runs
    assert record.least_period_s == pytest.approx(0.7 * period_s), "the plan allows it"
    bench.session.handle_event(RunEnded(3, at_s, 5, "clear"), at_s)
    bench.session.tick(30.0)
    (finished,) = bench.of(RunFinished)
    assert finished.head.trigger_times_s == pytest.approx([0.8 * row * period_s for row in range(5)])
    assert finished.head.belt_mm == (0.0, 10.0, 20.0, 30.0, 40.0)
