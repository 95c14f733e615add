"""The session with devices made of wood: what is told when a device misbehaves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from vaoi_station.acquisition.cameras.interface import Arrival, CameraBack, CameraLost, Slot
from vaoi_station.acquisition.clocks import ClockModel, ClockReading
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
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
    RunFinished,
    RunStarted,
    Trouble,
)
from vaoi_station.acquisition.process.session import Session
from vaoi_station.acquisition.ring.ring import Ring, RingLayout, ring_path
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, InputError, StateError
from vaoi_station.model import Verdict


@dataclass
class Wood:
    """A camera and a controller that do nothing of themselves."""

    slots: list[Slot] = field(default_factory=list)
    plans: list[TriggerPlan | None] = field(default_factory=list)
    refuses: bool = False
    fired: int = 0

    def queue(self, slot: Slot) -> None:
        self.slots.append(slot)

    def take_back(self) -> list[int]:
        numbers = [s.number for s in self.slots]
        self.slots.clear()
        return numbers

    def arm(self, plan: TriggerPlan) -> None:
        if self.refuses:
            raise DeviceError("the port is gone.", action="Plug it in.")
        self.plans.append(plan)

    def disarm(self) -> None:
        self.plans.append(None)

    def fire_one(self) -> None:
        if self.refuses:
            raise DeviceError("the port is gone.", action="Plug it in.")
        self.fired += 1


@dataclass
class Stage:
    """A session, its wooden devices, and what it said. All clocks show the host's time."""

    session: Session
    cameras: list[Wood]
    controller: Wood
    clocks: list[ClockModel]
    said: list[Any]
    plan: TriggerPlan

    def of(self, kind: type[Any]) -> list[Any]:
        return [s for s in self.said if isinstance(s, kind)]

    def pulse(self, at_s: float, row: int) -> None:
        self.session.heard(PulseFired(0, at_s, row), at_s)

    def frames(self, at_s: float, row: int) -> None:
        for n, camera in enumerate(self.cameras):
            slot = camera.slots.pop(0)
            self.session.arrived(Arrival(n, slot.number, True, row + 1, at_s, at_s + 0.01), at_s + 0.01)


@pytest.fixture
def stage(make_config: Callable[..., StationConfig]) -> Iterator[Stage]:
    config = make_config()
    with Ring.create(ring_path(config), RingLayout.of(config)) as ring:
        cameras, controller = [Wood(), Wood()], Wood()
        said: list[Any] = []
        clocks = [ClockModel(name) for name in ("controller", "camera c0", "camera c1")]
        for clock in clocks:
            clock.add(ClockReading(0.0, 0.0, 1e-5))
        devices = Devices(cameras, controller)  # type: ignore[arg-type]  # as much of them as a session asks for
        session = Session(config, ring, devices, clocks[0], clocks[1:], said.append)
        yield Stage(session, cameras, controller, clocks, said, TriggerPlan.of(config.line))


def test_slots_are_in_the_cameras_before_the_controller_is_armed(stage: Stage) -> None:
    stage.session.grant(Grant("a", 0))
    assert stage.cameras[0].slots == []
    stage.session.arm(stage.plan)
    assert len(stage.cameras[0].slots) > stage.plan.max_rows
    assert stage.said == [Armed()]
    stage.session.arm(stage.plan)
    assert len(stage.controller.plans) == 1, "the same plan again changes nothing"


def test_arming_is_refused_while_a_clock_is_unknown(stage: Stage) -> None:
    stage.clocks[2] = ClockModel("camera c1")
    stage.session._clocks[2] = stage.clocks[2]
    stage.clocks[2].add(ClockReading(0.0, 0.0, 0.01))
    with pytest.raises(DeviceError, match="camera c1: its clock is known to"):
        stage.session.arm(stage.plan)
    assert stage.controller.plans == []


def test_the_clock_of_a_camera_that_is_away_is_not_waited_for(stage: Stage) -> None:
    stage.session._clocks[2] = ClockModel("camera c1")
    stage.session.lost(CameraLost(1, 0.5, "it does not answer any more", DeviceError("camera c1: is gone.")))
    stage.session.arm(stage.plan)
    assert stage.of(Armed)
    stage.session.back(CameraBack(1, 0.6, ClockReading(0.0, 0.0, 1e-5)))
    with pytest.raises(DeviceError, match="camera c1"):
        stage.session.arm(stage.plan)


def test_a_period_too_short_for_exposure_and_read_out_is_refused_with_the_numbers(stage: Stage) -> None:
    slow = stage.session._config.cameras[0].model_copy(update={"exposure_us": 60_000.0, "readout_us": 45_000.0})
    stage.session._config = stage.session._config.model_copy(update={"cameras": (slow,)})
    with pytest.raises(InputError, match=r"period_s is 0\.1, but must be at least 0\.105: camera 'c0'"):
        stage.session.arm(replace(stage.plan, period_s=0.1))
    assert stage.controller.plans == []
    stage.session.arm(replace(stage.plan, period_s=0.105))


def test_rows_the_controller_left_out_are_missing_for_that_reason(stage: Stage) -> None:
    """The first one before any pulse was fired."""
    stage.session.grant(Grant("a", 0))
    stage.session.arm(stage.plan)
    stage.session.heard(BarrierBlocked(0, 1.0), 1.0)
    stage.session.heard(PulseSkipped(1, 1.1, 0, "hot"), 1.1)
    stage.pulse(1.2, 1)
    stage.frames(1.2, 1)
    stage.session.heard(PulseSkipped(3, 1.3, 2, "late"), 1.3)
    stage.session.heard(RunEnded(4, 1.4, 3, "clear"), 1.4)
    stage.session.tick(9.0)
    (finished,) = stage.of(RunFinished)
    causes = {(f.camera, f.row): f.cause for f in finished.frames if f.verdict is not Verdict.OK}
    assert causes == {(0, 0): "hot", (1, 0): "hot", (0, 2): "late", (1, 2): "late"}


def test_a_controller_that_refuses_leaves_the_station_disarmed_and_memory_returnable(stage: Stage) -> None:
    stage.controller.refuses = True
    stage.session.grant(Grant("a", 0))
    with pytest.raises(DeviceError):
        stage.session.arm(stage.plan)
    stage.session.disarmed(1.0)
    assert stage.of(Disarmed) == [Disarmed((Grant("a", 0),))]
    assert stage.cameras[0].slots == []
    stage.controller.refuses = False
    stage.session.arm(stage.plan)
    assert stage.of(Armed)


def test_a_controller_that_falls_silent_is_told_and_the_run_finished(stage: Stage) -> None:
    stage.session.grant(Grant("a", 0))
    stage.session.arm(stage.plan)
    stage.pulse(10.0, 0)
    stage.frames(10.0, 0)
    silent_s = stage.session.deadline_s(10.1)
    stage.session.tick(silent_s)
    (trouble,) = stage.of(Trouble)
    assert "has not ended run a" in trouble.message
    (finished,) = stage.of(RunFinished)
    assert finished.head.rows == 1
    assert finished.reason == "the controller fell silent"


def test_what_is_told_too_late_of_a_run_that_was_given_up_begins_no_other(stage: Stage) -> None:
    """The line is back after a while, and the controller's reports are read again."""
    stage.session.grant(Grant("a", 0))
    stage.session.grant(Grant("b", 1))
    stage.session.arm(stage.plan)
    stage.session.heard(BarrierBlocked(0, 9.9), 9.9)
    stage.pulse(10.0, 0)
    silent_s = stage.session.deadline_s(10.1)
    stage.session.tick(silent_s)
    stage.session.tick(silent_s + 1.0)
    stage.session.heard(PulseFired(0, 10.1, 1), silent_s + 2.0)
    stage.session.heard(RunEnded(0, 10.2, 2, "clear"), silent_s + 2.0)
    assert [started.run for started in stage.of(RunStarted)] == ["a"]
    assert not stage.of(BoardMissed)
    stage.session.heard(BarrierBlocked(0, silent_s + 3.0), silent_s + 3.0)
    stage.pulse(silent_s + 3.1, 0)
    assert [started.run for started in stage.of(RunStarted)] == ["a", "b"]


def test_a_run_whose_end_was_lost_is_ended_by_the_next_board(stage: Stage) -> None:
    for n in range(2):
        stage.session.grant(Grant(f"run {n}", n))
    stage.session.arm(stage.plan)
    stage.pulse(10.0, 0)
    stage.frames(10.0, 0)
    stage.pulse(20.0, 0)
    stage.frames(20.0, 0)
    stage.session.heard(RunEnded(0, 20.01, 1, "clear"), 20.02)
    assert [(f.run, f.reason) for f in stage.of(RunFinished)] == [
        ("run 0", "the controller did not report its end"),
        ("run 1", "clear"),
    ]
    assert all(f.verdict is Verdict.OK for r in stage.of(RunFinished) for f in r.frames)


def test_the_next_slots_are_queued_as_soon_as_a_run_is_finished(stage: Stage) -> None:
    for n in range(2):
        stage.session.grant(Grant(f"run {n}", n))
    stage.session.arm(stage.plan)
    stage.pulse(10.0, 0)
    stage.session.heard(RunEnded(0, 10.0, 1, "clear"), 10.005)
    before = {s.number for s in stage.cameras[0].slots}
    stage.frames(10.0, 0)
    after = {s.number for s in stage.cameras[0].slots}
    assert stage.of(RunFinished)
    assert after
    assert not after & before


def test_a_board_that_comes_while_late_frames_are_awaited_finds_slots(stage: Stage) -> None:
    for n in range(2):
        stage.session.grant(Grant(f"run {n}", n))
    stage.session.arm(stage.plan)
    stage.pulse(10.0, 0)
    stage.session.heard(RunEnded(0, 10.0, 1, "clear"), 10.0)
    stage.session.heard(BarrierBlocked(0, 10.1), 10.1)
    stage.pulse(10.2, 0)
    stage.frames(10.2, 0)
    assert [r.run for r in stage.of(RunStarted)] == ["run 0", "run 1"]
    stage.session.tick(11.0)
    (late,) = stage.of(RunFinished)
    assert {f.verdict for f in late.frames} == {Verdict.MISSING}


def test_an_interruption_without_a_pulse_keeps_the_grant(stage: Stage) -> None:
    stage.session.grant(Grant("a", 0))
    stage.session.arm(stage.plan)
    stage.session.heard(BarrierBlocked(0, 10.0), 10.0)
    stage.session.heard(RunEnded(1, 10.1, 0, "clear"), 10.1)
    assert "no pulse was fired" in stage.of(BoardMissed)[0].reason
    stage.pulse(20.0, 0)
    assert stage.of(RunStarted)[0].run == "a"


def test_another_plan_while_a_board_passes_is_refused(stage: Stage) -> None:
    stage.session.grant(Grant("a", 0))
    stage.session.arm(stage.plan)
    other = replace(stage.plan, max_rows=2)
    stage.session.arm(other)
    assert stage.controller.plans == [stage.plan, None, other]
    stage.pulse(10.0, 0)
    with pytest.raises(StateError, match="passing"):
        stage.session.arm(stage.plan)


def test_a_pulse_without_the_barrier_is_a_run_of_one_row_with_memory_beforehand(stage: Stage) -> None:
    with pytest.raises(StateError, match="no memory for a pulse"):
        stage.session.fire_one(0.9)
    for n in range(2):
        stage.session.grant(Grant(f"pulse {n}", n))
    assert stage.cameras[0].slots == [], "nothing is loaded before it is asked for"
    for n, at_s in enumerate((1.0, 1.3)):  # the second comes while the first waits for a frame of camera 1
        stage.session.fire_one(at_s)
        assert (stage.controller.fired, len(stage.cameras[0].slots) > 0) == (n + 1, True)
        stage.pulse(at_s, 0)
        stage.session.heard(RunEnded(0, at_s, 1, "single"), at_s)
        slot = stage.cameras[0].slots.pop(0)
        stage.session.arrived(Arrival(0, slot.number, True, n + 1, at_s, at_s + 0.01), at_s + 0.01)
    assert [(r.run, r.host_time_s) for r in stage.of(RunStarted)] == [("pulse 0", 1.0), ("pulse 1", 1.3)]
    assert stage.of(RunFinished) == []
    stage.session.tick(stage.session.deadline_s(1.4))
    stage.session.tick(3.0)
    for finished in stage.of(RunFinished):
        assert (finished.head.rows, finished.reason) == (1, "single")
        assert [f.verdict for f in finished.frames] == [Verdict.OK, Verdict.MISSING]
    assert len(stage.of(RunFinished)) == 2
    assert stage.of(BoardMissed) == []


def test_a_pulse_that_is_refused_leaves_its_memory_to_the_next(stage: Stage) -> None:
    stage.session.grant(Grant("a", 0))
    stage.controller.refuses = True
    with pytest.raises(DeviceError, match="the port is gone"):
        stage.session.fire_one(1.0)
    stage.controller.refuses = False
    stage.session.fire_one(1.1)
    stage.pulse(1.1, 0)
    assert [r.run for r in stage.of(RunStarted)] == ["a"]


def test_single_pulses_and_boards_do_not_mix(stage: Stage) -> None:
    stage.session.grant(Grant("a", 0))
    stage.session.arm(stage.plan)
    with pytest.raises(StateError, match="boards are being filmed"):
        stage.session.fire_one(1.0)
    assert stage.controller.fired == 0
    stage.session.disarmed(1.1)
    assert stage.of(Disarmed)[0].unused == (Grant("a", 0),)
    stage.session.grant(Grant("b", 0))
    stage.session.fire_one(1.2)
    assert stage.controller.fired == 1
