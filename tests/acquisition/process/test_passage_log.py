"""Every edge belongs to one passage, and a board that passes without a run is reported once, at its host time."""

from __future__ import annotations

import pytest

from vaoi_station.acquisition.clocks import ClockModel, ClockReading
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierBlockedAgain,
    BarrierClear,
    BarrierClearAfterRun,
    BoardTooSoon,
)
from vaoi_station.acquisition.process.messages import BoardMissed
from vaoi_station.acquisition.process.passages import PassageLog

AHEAD_S = 1000.0
"""The host's time minus the controller's."""


@pytest.fixture
def log() -> PassageLog:
    clock = ClockModel("controller")
    clock.add(ClockReading(0.0, AHEAD_S, 1e-5))
    return PassageLog(clock)


def test_a_passage_has_all_interruptions_from_its_first_edge_on(log: PassageLog) -> None:
    edges = [BarrierBlocked(0, 1.0), BarrierClear(1, 1.5), BarrierBlockedAgain(2, 1.6), BarrierClearAfterRun(3, 2.0)]
    assert [log.add(event, AHEAD_S + 9.0) for event in edges] == [None] * 4
    assert (log.edge_s, log.barrier.interruptions) == (AHEAD_S + 1.0, [(1.0, 1.5), (1.6, 2.0)])
    log.add(BarrierBlocked(4, 3.0), AHEAD_S + 2.9)
    assert log.edge_s == AHEAD_S + 2.9, "no edge lies in the future"
    assert log.begin_run().interruptions == [(3.0, None)]
    log.barrier.over = True
    assert log.begin_run().interruptions == [], "the edge of this run was not reported"
    log.begin_single(AHEAD_S + 5.0)
    assert (log.edge_s, log.barrier.interruptions) == (AHEAD_S + 5.0, [])


def test_a_board_without_a_run_is_missed_once(log: PassageLog) -> None:
    stood = log.add(BarrierClearAfterRun(0, 1.0), AHEAD_S + 1.1)
    assert stood == BoardMissed(AHEAD_S + 1.0, "it stood in the barrier when the line was armed")
    soon = log.add(BoardTooSoon(1, 2.0, 0.25), AHEAD_S + 2.1)
    assert soon == BoardMissed(AHEAD_S + 2.0, "it came 0.250 s after the one before had left")
    assert log.add(BarrierClearAfterRun(2, 2.5), AHEAD_S + 2.6) is None
