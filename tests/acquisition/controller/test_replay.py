"""The replay controller: recorded times to the nanosecond, with and without a pace."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from itertools import pairwise
from queue import SimpleQueue

import pytest

from vaoi_station.acquisition.cameras.interface import DeviceFault
from vaoi_station.acquisition.clocks import DeviceClock
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierClear,
    EventQueue,
    PulseFired,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.devices import Feedback
from vaoi_station.acquisition.replay import GAP_S, LEAD_S, FastPace, RecordedRow, ReplayController
from vaoi_station.errors import InputError, StateError

PLAN = TriggerPlan(start_delay_s=0.1, period_s=0.02, tail_s=0.1, max_rows=5, debounce_s=0.005)
TIMES_S = (0.0, 0.020000001, 0.04)


class CountingPace(FastPace):
    """Lets everything pass, and counts frames."""

    def __init__(self) -> None:
        super().__init__(Feedback())
        self.frames = 0
        self.woken = threading.Event()

    def before_run(self, stop: Callable[[], bool]) -> None: ...

    def before_pulse(self, stop: Callable[[], bool]) -> None: ...

    def frames_coming(self, frames: int) -> None:
        self.frames += frames

    def wake(self) -> None:
        self.woken.set()


class Bench:
    """A replay of runs and the device times at which rows were delivered."""

    def __init__(self, runs: int, pace: CountingPace | None, times_s: tuple[float, ...] = TIMES_S) -> None:
        self.delivered: list[float] = []
        rows = [RecordedRow(t, "top", (250.0,), self._deliver) for t in times_s]
        self.events: EventQueue = SimpleQueue()
        self.controller = ReplayController(iter([rows] * runs), DeviceClock(), 0.0, pace)
        self.controller.start(self.events)

    def _deliver(self, device_s: float) -> int:
        self.delivered.append(device_s)
        return 2

    def run(self) -> list[object]:
        events: list[object] = [self.events.get(timeout=10)]
        while not isinstance(events[-1], RunEnded):
            events.append(self.events.get(timeout=10))
        return events


@pytest.fixture
def make() -> Iterator[Callable[..., Bench]]:
    benches: list[Bench] = []

    def begin(runs: int = 1, pace: CountingPace | None = None, times_s: tuple[float, ...] = TIMES_S) -> Bench:
        benches.append(Bench(runs, pace, times_s))
        return benches[-1]

    yield begin
    for bench in benches:
        bench.controller.close()


@pytest.mark.parametrize("paced", [True, False])
def test_a_run_has_the_recorded_times(make: Callable[..., Bench], paced: bool) -> None:
    pace = CountingPace() if paced else None
    bench = make(pace=pace)
    bench.controller.arm(PLAN)
    events = bench.run()
    pulses = [e for e in events if isinstance(e, PulseFired)]
    assert [round(p.time_s - pulses[0].time_s, 9) for p in pulses] == list(TIMES_S)
    assert bench.delivered == [p.time_s for p in pulses]
    assert isinstance(events[0], BarrierBlocked)
    assert pulses[0].time_s - events[0].time_s == pytest.approx(LEAD_S, abs=1e-9)
    assert not any(isinstance(e, BarrierClear) for e in events), "a recording does not hold when its board left"
    assert isinstance(events[-1], RunEnded)
    assert (events[-1].pulses, events[-1].reason) == (3, "clear")
    assert pulses[1].exposures_us == (250.0,)
    assert pace is None or pace.frames == 6


def test_paced_runs_do_not_overlap_on_the_clock_of_the_device(make: Callable[..., Bench]) -> None:
    bench = make(runs=3, pace=CountingPace(), times_s=(0.0, 30.0))
    bench.controller.arm(PLAN)
    ends = [bench.run() for _ in range(3)]
    for earlier, later in pairwise(ends):
        last = [e for e in earlier if isinstance(e, PulseFired)][-1]
        assert isinstance(later[0], BarrierBlocked)
        assert later[0].time_s >= last.time_s + GAP_S


def test_disarming_cuts_a_run_short(make: Callable[..., Bench]) -> None:
    bench = make(times_s=(0.0, 3600.0))
    bench.controller.arm(PLAN)
    while not isinstance(bench.events.get(timeout=10), PulseFired):
        pass
    bench.controller.disarm()
    end = bench.events.get_nowait()
    assert isinstance(end, RunEnded)
    assert (end.pulses, end.reason) == (1, "disarmed")


def test_nothing_is_played_before_it_is_armed(make: Callable[..., Bench]) -> None:
    pace = CountingPace()
    bench = make(pace=pace)
    bench.controller.disarm()
    assert pace.woken.is_set()
    assert bench.events.empty()
    bench.controller.arm(PLAN)
    assert len(bench.run()) == 5


def test_a_plan_with_too_few_rows_is_reported(make: Callable[..., Bench]) -> None:
    bench = make(times_s=tuple(0.01 * k for k in range(6)))
    bench.controller.arm(PLAN)
    fault = bench.events.get(timeout=10)
    assert isinstance(fault, DeviceFault)
    assert "max_rows is 5, but must be at least the 6 rows" in fault.error.message


def test_a_recording_that_cannot_be_read_is_reported() -> None:
    def runs() -> Iterator[list[RecordedRow]]:
        yield from map(damaged, [1])

    def damaged(_number: int) -> list[RecordedRow]:
        raise InputError("run.json: is damaged.", action="Replace it.")

    events: EventQueue = SimpleQueue()
    controller = ReplayController(runs(), DeviceClock(), 0.0, None)
    controller.start(events)
    fault = events.get(timeout=10)
    controller.close()
    assert isinstance(fault, DeviceFault)
    assert fault.error.message == "run.json: is damaged."


def test_it_fires_no_pulse_of_its_own(make: Callable[..., Bench]) -> None:
    with pytest.raises(StateError, match="replay"):
        make().controller.fire_one()


def test_its_clock_is_the_hosts(make: Callable[..., Bench]) -> None:
    bench = make()
    assert bench.controller.read_clock().bound_s == 0.0
    assert bench.controller.health() == "replay: 0 runs played"
