"""The session: grants, arming, runs, and what comes late."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from vaoi_station.acquisition.cameras.interface import Arrival, CameraExposure, CameraHealth, Slot
from vaoi_station.acquisition.clocks import ClockModel, ClockReading
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierBlockedAgain,
    BarrierClear,
    BarrierClearAfterRun,
    BeltPacing,
    PulseFired,
    PulseSkipped,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.process.messages import (
    Armed,
    BoardMissed,
    Disarmed,
    Grant,
    MissedPassage,
    RunFinished,
    RunStarted,
    Trouble,
)
from vaoi_station.acquisition.process.session import Session
from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, InputError, StateError
from vaoi_station.line_config import Encoder
from vaoi_station.model import ProgramRow, Verdict


@dataclass
class ScriptedDevice:
    """A camera and a controller that record calls and do nothing else."""

    slots: list[Slot] = field(default_factory=list)
    plans: list[TriggerPlan | None] = field(default_factory=list)
    refuses: bool = False
    fired: int = 0
    exposures: list[tuple[float, float]] = field(default_factory=list)
    refused: list[tuple[float, float]] = field(default_factory=list)

    def set_exposure(self, wanted: CameraExposure) -> None:
        if (value := (wanted.exposures_us[0], wanted.gain_db)) in self.refused:
            raise DeviceError(f"the camera refuses {value[0]:g} µs.")
        self.exposures.append(value)

    def rewind(self) -> None:
        """Do nothing: there is no sequencer."""

    def queue(self, slot: Slot) -> None:
        self.slots.append(slot)

    def take_back(self) -> list[int]:
        slots, self.slots = self.slots, []
        return [s.number for s in slots]

    def arm(self, plan: TriggerPlan) -> None:
        if self.refuses:
            raise DeviceError("the port is gone.", action="Plug it in.")
        self.plans.append(plan)

    def disarm(self) -> None:
        self.plans.append(None)

    def fire_one(self, light: str = "", on_us: float | None = None) -> None:
        if self.refuses:
            raise DeviceError("the port is gone.", action="Plug it in.")
        self.fired += 1

    def health(self) -> CameraHealth:
        return CameraHealth(True)


@dataclass
class SessionBench:
    """A session, its scripted devices, and its reports. All clocks show the host's time."""

    session: Session
    cameras: list[ScriptedDevice]
    controller: ScriptedDevice
    reports: list[Any]
    plan: TriggerPlan

    def of(self, kind: type[Any]) -> list[Any]:
        return [s for s in self.reports if isinstance(s, kind)]

    def pulse(self, at_s: float, row: int) -> None:
        self.session.handle_event(PulseFired(0, at_s, row), at_s)

    def frames(self, at_s: float, row: int) -> None:
        for n, camera in enumerate(self.cameras):
            slot = camera.slots.pop(0)
            arrival = Arrival(n, slot.number, True, row + 1, at_s, at_s + 0.01)
            self.session.handle_arrival(arrival, at_s + 0.01, at_s + 0.01)


@contextmanager
def session_bench(
    config: StationConfig, bounds_s: tuple[float | None, ...] = (1e-5, 1e-5, 1e-5)
) -> Iterator[SessionBench]:
    """Open a session; `bounds_s`: of the readings of controller and cameras, None for a clock that was never read."""
    with Ring.create(ring_path(config), RingLayout.of(config)) as ring:
        cameras, controller = [ScriptedDevice(), ScriptedDevice()], ScriptedDevice()
        reports: list[Any] = []
        clocks = [ClockModel(name) for name in ("controller", "camera c0", "camera c1")]
        for clock, bound_s in zip(clocks, bounds_s, strict=True):
            if bound_s is not None:
                clock.add(ClockReading(0.0, 0.0, bound_s))
        devices = Devices(cameras, controller)  # type: ignore[arg-type]  # they have what a session uses
        session = Session(config, ring, devices, clocks[0], clocks[1:], reports.append)
        yield SessionBench(session, cameras, controller, reports, TriggerPlan.of(config.line))


@pytest.fixture
def bench(make_config: Callable[..., StationConfig]) -> Iterator[SessionBench]:
    with session_bench(make_config()) as bench:
        yield bench


def test_slots_are_in_the_cameras_before_the_controller_is_armed(bench: SessionBench) -> None:
    bench.session.grant(Grant("a", 0))
    assert bench.cameras[0].slots == []
    bench.session.arm(bench.plan)
    assert len(bench.cameras[0].slots) > bench.plan.max_rows
    assert bench.reports == [Armed()]
    bench.session.arm(bench.plan)
    assert len(bench.controller.plans) == 1, "the same plan again changes nothing"


def test_arming_is_refused_while_a_clock_is_unknown(make_config: Callable[..., StationConfig]) -> None:
    with session_bench(make_config(), (1e-5, 1e-5, 0.01)) as bench:
        with pytest.raises(DeviceError, match="camera c1: times of its clock may be wrong by"):
            bench.session.arm(bench.plan)
        assert bench.controller.plans == []


def test_arming_does_not_wait_for_the_clock_of_a_lost_camera(make_config: Callable[..., StationConfig]) -> None:
    with session_bench(make_config(), (1e-5, 1e-5, None)) as bench:
        bench.session.outages.begin(1, 0.5, "it does not answer any more")
        bench.session.arm(bench.plan)
        assert bench.of(Armed)
        bench.session.outages.end(1, 0.6)
        with pytest.raises(DeviceError, match="camera c1"):
            bench.session.arm(bench.plan)


def test_skipped_rows_are_missing_with_the_reason_of_the_controller(bench: SessionBench) -> None:
    """Row 0 is skipped before any pulse was fired."""
    bench.session.grant(Grant("a", 0))
    bench.session.arm(bench.plan)
    bench.session.handle_event(BarrierBlocked(0, 1.0), 1.0)
    bench.session.handle_event(PulseSkipped(1, 1.1, 0, "hot"), 1.1)
    bench.pulse(1.2, 1)
    bench.frames(1.2, 1)
    bench.session.handle_event(PulseSkipped(3, 1.3, 2, "late"), 1.3)
    bench.session.handle_event(RunEnded(4, 1.4, 3, "clear"), 1.4)
    bench.session.tick(9.0)
    (finished,) = bench.of(RunFinished)
    causes = {(f.camera, f.row): f.cause for f in finished.frames if f.verdict is not Verdict.OK}
    assert causes == {(0, 0): "hot", (1, 0): "hot", (0, 2): "late", (1, 2): "late"}


def test_a_controller_that_refuses_leaves_the_station_disarmed_and_memory_returnable(bench: SessionBench) -> None:
    bench.controller.refuses = True
    bench.session.grant(Grant("a", 0))
    with pytest.raises(DeviceError):
        bench.session.arm(bench.plan)
    bench.session.finish_disarming(1.0)
    assert bench.of(Disarmed) == [Disarmed((Grant("a", 0),))]
    assert bench.cameras[0].slots == []
    bench.controller.refuses = False
    bench.session.arm(bench.plan)
    assert bench.of(Armed)


def test_a_changed_plan_that_fails_leaves_the_station_not_armed_with_the_reason(bench: SessionBench) -> None:
    """The controller was disarmed for the change, so the plan before is not in force either."""
    bench.session.grant(Grant("a", 0))
    bench.session.arm(bench.plan)
    bench.controller.refuses = True
    with pytest.raises(DeviceError, match="is not armed: its plan could not be changed: the port is gone") as failed:
        bench.session.arm(replace(bench.plan, max_rows=2))
    assert failed.value.action == "Plug it in."
    bench.controller.refuses = False
    bench.session.arm(bench.plan)
    assert bench.controller.plans == [bench.plan, None, bench.plan], "the controller receives the first plan again"


def test_a_plan_that_is_refused_beforehand_leaves_the_present_one_in_force(bench: SessionBench) -> None:
    bench.session.arm(bench.plan)
    with pytest.raises(InputError, match="max_rows"):
        bench.session.arm(replace(bench.plan, max_rows=1000))
    bench.session.arm(bench.plan)
    assert bench.controller.plans == [bench.plan]


def test_a_controller_that_stops_reporting_is_a_fault_and_the_run_is_finished(bench: SessionBench) -> None:
    bench.session.grant(Grant("a", 0))
    bench.session.arm(bench.plan)
    bench.pulse(10.0, 0)
    bench.frames(10.0, 0)
    deadline_s = bench.session.deadline_s(10.1)
    bench.session.tick(deadline_s)
    (trouble,) = bench.of(Trouble)
    assert "has not reported the end of run a" in trouble.message
    (finished,) = bench.of(RunFinished)
    assert finished.head.rows == 1
    assert finished.reason == "the controller stopped reporting"


def test_late_events_of_a_given_up_run_begin_no_other_run(bench: SessionBench) -> None:
    """The connection is back after a while, and the controller's reports are read."""
    bench.session.grant(Grant("a", 0))
    bench.session.grant(Grant("b", 1))
    bench.session.arm(bench.plan)
    bench.session.handle_event(BarrierBlocked(0, 9.9), 9.9)
    bench.pulse(10.0, 0)
    deadline_s = bench.session.deadline_s(10.1)
    bench.session.tick(deadline_s)
    bench.session.tick(deadline_s + 1.0)
    bench.session.handle_event(PulseFired(0, 10.1, 1), deadline_s + 2.0)
    bench.session.handle_event(RunEnded(0, 10.2, 2, "clear"), deadline_s + 2.0)
    assert [started.run for started in bench.of(RunStarted)] == ["a"]
    assert not bench.of(BoardMissed)
    bench.session.handle_event(BarrierBlocked(0, deadline_s + 3.0), deadline_s + 3.0)
    bench.pulse(deadline_s + 3.1, 0)
    assert [started.run for started in bench.of(RunStarted)] == ["a", "b"]


def test_a_run_whose_end_was_lost_is_ended_by_the_next_board(bench: SessionBench) -> None:
    for n in range(2):
        bench.session.grant(Grant(f"run {n}", n))
    bench.session.arm(bench.plan)
    bench.pulse(10.0, 0)
    bench.frames(10.0, 0)
    bench.pulse(20.0, 0)
    bench.frames(20.0, 0)
    bench.session.handle_event(RunEnded(0, 20.01, 1, "clear"), 20.02)
    assert [(f.run, f.reason) for f in bench.of(RunFinished)] == [
        ("run 0", "the controller did not report its end"),
        ("run 1", "clear"),
    ]
    assert all(f.verdict is Verdict.OK for r in bench.of(RunFinished) for f in r.frames)


def test_a_board_finds_slots_while_late_frames_of_another_are_awaited(bench: SessionBench) -> None:
    for n in range(2):
        bench.session.grant(Grant(f"run {n}", n))
    bench.session.arm(bench.plan)
    bench.pulse(10.0, 0)
    bench.session.handle_event(RunEnded(0, 10.0, 1, "clear"), 10.0)
    bench.session.handle_event(BarrierBlocked(0, 10.1), 10.1)
    bench.pulse(10.2, 0)
    bench.frames(10.2, 0)
    assert [r.run for r in bench.of(RunStarted)] == ["run 0", "run 1"]
    bench.session.tick(11.0)
    (late,) = bench.of(RunFinished)
    assert {f.verdict for f in late.frames} == {Verdict.MISSING}


def test_an_interruption_without_a_pulse_keeps_the_grant(bench: SessionBench) -> None:
    bench.session.grant(Grant("a", 0))
    bench.session.arm(bench.plan)
    bench.session.handle_event(BarrierBlocked(0, 10.0), 10.0)
    bench.session.handle_event(RunEnded(1, 10.1, 0, "clear"), 10.1)
    assert "no pulse was fired" in bench.of(BoardMissed)[0].reason
    bench.pulse(20.0, 0)
    assert bench.of(RunStarted)[0].run == "a"


def test_another_plan_while_a_board_passes_is_refused(bench: SessionBench) -> None:
    bench.session.grant(Grant("a", 0))
    bench.session.arm(bench.plan)
    other = replace(bench.plan, max_rows=2)
    bench.session.arm(other)
    assert bench.controller.plans == [bench.plan, None, other]
    bench.pulse(10.0, 0)
    with pytest.raises(StateError, match="passing"):
        bench.session.arm(bench.plan)


def test_a_refused_pulse_leaves_its_grant_to_the_next(bench: SessionBench) -> None:
    bench.session.grant(Grant("a", 0))
    bench.controller.refuses = True
    with pytest.raises(DeviceError, match="the port is gone"):
        bench.session.fire_one(1.0)
    bench.controller.refuses = False
    bench.session.fire_one(1.1)
    bench.pulse(1.1, 0)
    assert [r.run for r in bench.of(RunStarted)] == ["a"]


def test_a_program_sets_the_cameras_and_is_in_every_record(bench: SessionBench) -> None:
    bench.session.grant(Grant("a", 0))
    row = ProgramRow("left", (200.0, 300.0), (0.0, 6.0), 80.0)
    bench.session.arm(replace(bench.plan, program=(row,), lights=("left",)))
    assert [camera.exposures for camera in bench.cameras] == [[(200.0, 0.0)], [(300.0, 6.0)]]
    bench.session.handle_event(BarrierBlocked(0, 1.0), 1.0)
    bench.session.handle_event(PulseFired(1, 1.1, 0, "left", on_us=80.0), 1.1)
    bench.frames(1.1, 0)
    bench.session.handle_event(RunEnded(2, 1.2, 1, "clear"), 1.2)
    [finished] = bench.of(RunFinished)
    assert (finished.head.lights, finished.head.exposures_us) == (("left",), ((80.0, 80.0),))
    assert finished.head.gains == ((1.0, 1.995262),)
    assert [(f.light, f.exposure_us, f.gain) for f in finished.frames] == [
        ("left", 80.0, 1.0),
        ("left", 80.0, 1.995262),
    ]
    assert finished.proof.proven
    bench.session.arm(bench.plan)
    assert bench.cameras[0].exposures[-1] == (250.0, 0.0)


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
