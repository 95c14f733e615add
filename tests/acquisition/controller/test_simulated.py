"""The simulated controller in real time: what it fires, reports and refuses."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from queue import SimpleQueue
from typing import Any, cast

import pytest

from vaoi_station.acquisition.clocks import DeviceClock
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    EventQueue,
    LineOutput,
    Permit,
    PulseFired,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.simulated import SimulatedController
from vaoi_station.errors import InputError, InternalError, StateError

PLAN = TriggerPlan(start_delay_s=0.01, period_s=0.005, tail_s=0.01, max_rows=50, debounce_s=0.001, lights=("a", "b"))


class Bench:
    """A controller, and a line that records what it is driven to do."""

    def __init__(self) -> None:
        self.clock = DeviceClock(offset_s=1000.0, drift_ppm=50.0)
        self.fired: list[PulseFired] = []
        self.single: list[PulseFired] = []
        self.armed: list[bool] = []
        self.ended = 0
        self.permits: list[Permit | None] = []
        self.events: EventQueue = SimpleQueue()
        self.controller = SimulatedController(self.clock, cast("Any", self))
        self.controller.start(self.events)

    def start(self, _controller: object, _faults: object) -> None:
        pass

    def threads(self) -> tuple[()]:
        return ()

    def close(self) -> None:
        pass

    def accept(self, plan: TriggerPlan) -> TriggerPlan:
        return plan

    def lights(self) -> tuple[str, ...]:
        return ("ring",)

    def counts_at(self, time_s: float) -> int:
        raise InternalError("this line has no encoder")

    def time_of(self, counts: int) -> float:
        raise InternalError("this line has no encoder")

    def fire(self, event: PulseFired) -> None:
        self.fired.append(event)

    def fire_single(self, event: PulseFired) -> None:
        self.single.append(event)

    def set_armed(self, armed: bool) -> None:
        self.armed.append(armed)

    def end_run(self) -> None:
        self.ended += 1

    def permit_board(self, permit: Permit | None) -> None:
        self.permits.append(permit)

    def line_output(self) -> LineOutput | None:
        return LineOutput(bool(self.permits and self.permits[-1]))

    def board(self, length_s: float, lead_s: float = 0.005) -> float:
        """A board that blocks the barrier; the device time at which it does."""
        start_s = self.clock.now_s() + lead_s
        self.controller.schedule_edges([(start_s, True), (start_s + length_s, False)])
        return start_s

    def run(self) -> list[object]:
        """All events up to the end of a run."""
        events: list[object] = [self.events.get(timeout=10)]
        while not isinstance(events[-1], RunEnded):
            events.append(self.events.get(timeout=10))
        return events


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.controller.close()


def test_a_board_is_filmed_at_the_times_of_the_rule(bench: Bench) -> None:
    bench.controller.arm(PLAN)
    start_s = bench.board(0.02)
    events = bench.run()
    pulses = [e for e in events if isinstance(e, PulseFired)]
    assert isinstance(events[0], BarrierBlocked)
    assert events[0].time_s == start_s
    assert [p.time_s for p in pulses] == pytest.approx([start_s + 0.01 + 0.005 * k for k in range(len(pulses))])
    assert [p.light for p in pulses[:3]] == ["a", "b", "a"]
    assert bench.fired == pulses
    assert bench.ended == 1
    assert "1 boards seen" in bench.controller.health()


def test_a_pulse_is_not_fired_before_its_time(bench: Bench) -> None:
    bench.controller.arm(PLAN)
    bench.board(0.01)
    while True:
        event = bench.events.get(timeout=10)
        assert not isinstance(event, PulseFired) or event.time_s <= bench.clock.now_s()
        if isinstance(event, RunEnded):
            return


def test_disarming_ends_the_run_before_it_returns(bench: Bench) -> None:
    bench.controller.arm(replace(PLAN, period_s=60.0))
    bench.board(3600.0)
    while not isinstance(bench.events.get(timeout=10), PulseFired):
        pass
    bench.controller.disarm()
    end = bench.events.get_nowait()
    assert isinstance(end, RunEnded)
    assert (end.pulses, end.reason) == (1, "disarmed")
    assert bench.armed == [True, False]
    assert bench.ended == 1


def test_edges_from_before_the_arming_belong_to_no_run(bench: Bench) -> None:
    bench.controller.schedule_edges([(bench.clock.now_s() + 0.01, True)])
    bench.controller.arm(PLAN)
    start_s = bench.board(0.01, lead_s=0.03)
    (blocked,) = [e for e in bench.run() if isinstance(e, BarrierBlocked)]
    assert blocked.time_s == start_s


def test_one_pulse_without_a_board_is_a_run_of_one_row(bench: Bench) -> None:
    bench.controller.fire_one()
    pulse, end = bench.events.get_nowait(), bench.events.get_nowait()
    assert bench.single == [pulse]
    assert bench.fired == []
    assert isinstance(end, RunEnded)
    assert (end.pulses, end.reason) == (1, "single")


def test_an_armed_controller_fires_no_single_pulse(bench: Bench) -> None:
    bench.controller.arm(PLAN)
    with pytest.raises(StateError, match="armed"):
        bench.controller.fire_one()


def test_a_plan_that_cannot_be_carried_out_leaves_it_idle(bench: Bench) -> None:
    with pytest.raises(InputError, match="period_s"):
        bench.controller.arm(replace(PLAN, period_s=0.0))
    assert bench.armed == []
    assert "idle" in bench.controller.health()


def test_its_clock_is_read_within_the_bound(bench: Bench) -> None:
    before_s = time.monotonic()
    reading = bench.controller.read_clock()
    assert before_s <= reading.host_s <= time.monotonic()
    assert abs(bench.clock.host_s(reading.device_s) - reading.host_s) <= reading.bound_s + 1e-6


def test_permits_and_the_output_are_those_of_the_line(bench: Bench) -> None:
    permit = Permit(1, 5.0)
    bench.controller.permit_board(permit)
    assert bench.permits == [permit]
    assert bench.controller.line_output() == LineOutput(True)
    assert bench.controller.is_watching()
