"""The session: grants, arming, runs, and what comes late."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from vaoi_station.acquisition.cameras.interface import Arrival, CameraExposure, CameraHealth, CameraLimits, Slot
from vaoi_station.acquisition.clocks import ClockModel, ClockReading
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    Contacts,
    ContactsChanged,
    PulseFired,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.process.messages import (
    Armed,
    BoardMissed,
    Disarmed,
    Grant,
    RunFinished,
    RunStarted,
    Trouble,
)
from vaoi_station.acquisition.process.session import Session
from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, InputError
from vaoi_station.model import Verdict


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

    silences: list[int] = field(default_factory=list)

    def rewind(self) -> None:
        """Do nothing: there is no sequencer."""

    def sent_nothing(self, rows: int, since_s: float) -> None:
        del since_s
        self.silences.append(rows)

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

    row_s: float | None = None

    def health(self) -> CameraHealth:
        return CameraHealth(True, limits=CameraLimits(row_s=self.row_s))


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


def test_rows_that_come_faster_than_the_links_carry_them_are_refused(bench: SessionBench) -> None:
    bench.cameras[1].row_s = bench.plan.period_s * 1.01
    with pytest.raises(InputError, match=r"period_s is 0\.05, but must be at least 0\.0505: the links of the cameras"):
        bench.session.arm(bench.plan)
    bench.cameras[1].row_s = bench.plan.period_s
    bench.session.arm(bench.plan)


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


def test_a_camera_is_told_that_it_sent_nothing_of_a_run_that_another_filmed(bench: SessionBench) -> None:
    for run, (sends, outage) in enumerate((((0,), False), ((0,), True), ((), False), ((0, 1), False))):
        start_s = 10.0 + 10 * run
        bench.session.grant(Grant(f"run {run}", run % 2))
        bench.session.arm(bench.plan)
        bench.session.handle_event(BarrierBlocked(0, start_s - 0.1), start_s - 0.1)
        if outage:
            bench.session.outages.begin(1, start_s - 0.05, "unplugged")
        for row in range(3):
            bench.pulse(start_s + 0.1 * row, row)
            for camera in sends:
                at_s = start_s + 0.1 * row
                arrival = Arrival(camera, bench.cameras[camera].slots.pop(0).number, True, row + 1, at_s, at_s + 0.01)
                bench.session.handle_arrival(arrival, at_s + 0.01, at_s + 0.01)
        bench.session.handle_event(RunEnded(0, start_s + 0.4, 3, "clear"), start_s + 0.4)
        bench.session.tick(start_s + 8.0)
        bench.session.outages.end(1, start_s + 9.0)
        assert len(bench.of(RunFinished)) == run + 1
    assert [camera.silences for camera in bench.cameras] == [[], [3]], "not if it was lost, or if all were silent"


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


def test_a_refused_pulse_leaves_its_grant_to_the_next(bench: SessionBench) -> None:
    bench.session.grant(Grant("a", 0))
    bench.controller.refuses = True
    with pytest.raises(DeviceError, match="the port is gone"):
        bench.session.fire_one(1.0)
    bench.controller.refuses = False
    bench.session.fire_one(1.1)
    bench.pulse(1.1, 0)
    assert [r.run for r in bench.of(RunStarted)] == ["a"]


@pytest.mark.parametrize("edge_reported", [True, False])
def test_a_run_states_how_contacts_announced_its_board(bench: SessionBench, edge_reported: bool) -> None:
    """Also if the report of its edge was lost: a board that was announced as bad stays bad."""
    bench.session.grant(Grant("a", 0))
    bench.session.arm(bench.plan)
    for at_s, contacts in ((1.0, Contacts()), (2.0, Contacts(failed=True)), (3.0, Contacts())):
        bench.session.handle_event(ContactsChanged(0, at_s, contacts), at_s)
    if edge_reported:
        bench.session.handle_event(BarrierBlocked(0, 9.9), 9.9)
    bench.pulse(10.0, 0)
    assert [report.came for report in bench.of(RunStarted)] == ["failed"]
