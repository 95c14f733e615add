"""The acquisition process as a whole, and its inbox."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from vaoi_station.acquisition.cameras.interface import CameraExposure, CameraHealth, CameraLost
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.process import main_loop
from vaoi_station.acquisition.process.backends import open_devices
from vaoi_station.acquisition.process.main_loop import Inbox
from vaoi_station.acquisition.process.messages import (
    Armed,
    FireOne,
    FireTrial,
    Grant,
    Health,
    PulseReported,
    RunFinished,
    TrialFailed,
    Trouble,
)
from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError
from vaoi_station.model import Verdict
from vaoi_station.supervised_thread import SupervisedThread


class Clock:
    """A clock that a test sets, with the queue that passes this time when it waits."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 100.0
        self.late_s = 0.0
        """Time by which the next wait ends later than it should."""
        monkeypatch.setattr(main_loop, "monotonic", lambda: self.now_s)
        self.inbox = Inbox()
        real = self.inbox.messages
        clock = self

        class Waiting:
            def put(self, message: object) -> None:
                real.put(message)

            def empty(self) -> bool:
                return real.empty()

            def get(self, timeout: float) -> Any:
                clock.now_s += (timeout if real.empty() else 0.0) + clock.late_s
                clock.late_s = 0.0
                return real.get_nowait()

        self.inbox.messages = Waiting()  # type: ignore[assignment]

    def take(self, after_s: float = 0.0) -> Any:
        return self.inbox.take(self.now_s + after_s)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def test_frames_that_came_while_the_process_was_held_up_are_not_missing(
    start: Callable[..., Any], make_config: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loop is held up after the end of the pulses, until after the deadline of the frames."""
    held_up = threading.Event()

    def hold_up(loop: Any, _: float) -> None:
        if loop._session.awaits_clocks and not held_up.is_set():
            held_up.set()
            threading.Event().wait(1.0)

    monkeypatch.setattr(main_loop._MainLoop, "_disarm_when_due", hold_up)
    bench = start(make_config())
    bench.grant("one", 0)
    bench.send(FireOne())
    assert bench.until(RunFinished).head.missing == ()
    assert held_up.is_set()


Start = Callable[..., Any]
Make = Callable[..., StationConfig]
POOR_S = 2.7e-3
PATIENCE_S = 30.0


def counter() -> threading.Semaphore:
    return threading.Semaphore(0)


@dataclass
class BusyComputer:
    """A computer on which the first `poor` readings of the controller's clock have long round trips."""

    poor: float
    good: threading.Semaphore = field(default_factory=counter)
    """Counts the other readings."""
    controller: Any = None

    def open(self, config: StationConfig) -> Devices:
        devices = open_devices(config)
        self.controller = devices.controller
        return replace(devices, controller=self)

    def read_clock(self) -> ClockReading:
        reading: ClockReading = self.controller.read_clock()
        self.poor -= 1
        if self.poor >= 0:
            return replace(reading, bound_s=POOR_S)
        self.good.release()
        return reading

    def __getattr__(self, name: str) -> Any:
        return getattr(self.controller, name)


def busy(poor: int) -> Callable[[StationConfig], Devices]:
    return BusyComputer(poor).open


def test_arming_waits_until_the_clocks_are_known(start: Start, make_config: Make) -> None:
    """Neither the readings before the process is ready nor three more suffice."""
    bench = start(make_config(), open_backend=busy(main_loop.FIRST_READINGS + 3))
    bench.grant("one", 0)
    bench.arm()
    assert bench.of(Trouble) == []
    assert bench.until(RunFinished).head.missing == ()


def test_a_line_that_is_armed_during_a_trial_is_armed_after_its_last_frame(start: Start, make_config: Make) -> None:
    """The first board finds the cameras with its memory and with the exposures of its plan."""
    bench = start(make_config())
    exposures = tuple(CameraExposure((2 * c.exposure_us,), 0.0) for c in bench.config.cameras)
    bench.generations[1] = bench.ring.claim(1)
    bench.send(FireTrial(Grant("trial-1", 1), exposures))
    bench.arm(runs=1)
    kinds = [type(report) for report in bench.reports]
    assert kinds.index(RunFinished) < kinds.index(Armed)
    [trial] = bench.of(RunFinished)
    assert (trial.run, trial.bay, trial.reason, trial.head.missing) == ("trial-1", 1, "single", ())
    board = bench.until(RunFinished)
    assert (board.run, board.head.missing) == ("run 0", ())
    bench.send(FireTrial(Grant("trial-2", 1), exposures))
    failed = bench.until(TrialFailed)
    assert (failed.run, failed.why.code) == ("trial-2", "wrong-state")
    assert bench.of(Trouble) == []


class AbsentCamera:
    """A camera that could not be opened at the start."""

    def __init__(self, number: int, camera: Any) -> None:
        self.number, self.camera = number, camera
        self.error = DeviceError("camera c1: there is no camera.", code="camera-absent")

    def start(self, events: Any) -> None:
        events.put(CameraLost(self.number, 0.0, "it was never there", self.error))

    def read_clock(self) -> ClockReading:
        raise self.error

    def health(self) -> CameraHealth:
        return CameraHealth(connected=False, message=self.error.message)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.camera, name)


def test_a_camera_that_is_absent_at_the_start_keeps_no_other_from_filming(start: Start, make_config: Make) -> None:
    def open_without_the_second(config: StationConfig) -> Devices:
        devices = open_devices(config)
        return replace(devices, cameras=(devices.cameras[0], AbsentCamera(1, devices.cameras[1])))

    bench = start(make_config(), open_backend=open_without_the_second)
    assert bench.until(Trouble).code == "camera-absent"
    assert [camera.connected for camera in bench.until(Health).cameras] == [True, False]
    bench.grant("one", 0)
    bench.send(FireOne())
    assert [(frame.camera, frame.verdict) for frame in bench.until(RunFinished).frames][:1] == [(0, Verdict.OK)]


def test_a_board_that_is_passing_is_filmed_before_the_line_is_disarmed(start: Start, make_config: Make) -> None:
    bench = start(make_config())
    bench.grant("one", 0)
    bench.arm()
    bench.until(PulseReported)
    assert [h.passing for h in bench.of(Health)][-1], "reported before the first pulse"
    assert bench.disarm().unused == ()
    assert not bench.of(Health)[-1].passing
    [finished] = bench.of(RunFinished)
    assert finished.reason == "clear"
    assert finished.head.missing == ()


@pytest.mark.parametrize(
    ("name", "work", "hangs"), [("clocks", "_poll_clocks", True), ("commands", "_receive_commands", False)]
)
def test_a_thread_of_the_process_that_ends_or_hangs_ends_the_process(
    start: Start, make_config: Make, monkeypatch: pytest.MonkeyPatch, name: str, work: str, hangs: bool
) -> None:
    release = threading.Event()

    def stand(*_: object) -> None:
        if hangs:
            release.wait(PATIENCE_S)

    def impatient(target: Callable[[], object], thread: str, limit_s: float = PATIENCE_S) -> SupervisedThread:
        return SupervisedThread(target, thread, 0.2 if thread == name else limit_s)

    monkeypatch.setattr(main_loop, "SupervisedThread", impatient)
    monkeypatch.setattr(main_loop, "END_S", 0.1)
    monkeypatch.setattr(main_loop._MainLoop, work, stand)
    bench = start(make_config())
    trouble = bench.until(Trouble)
    release.set()
    for thread in threading.enumerate():
        if thread.name == name:  # the process did not wait for it
            thread.join(PATIENCE_S)
    assert trouble.code == "thread-lost"
    what = "hangs for" if hangs else "has ended without an error"
    assert f"In the acquisition process: Thread {name!r} {what}" in trouble.message


TWIN_THREADS = ("controller", "line", "camera-0", "camera-1")


@pytest.mark.parametrize(("name", "hangs"), [("controller", False), ("camera-1", True)])
def test_each_thread_of_a_device_that_ends_or_hangs_ends_the_process(
    start: Start, make_config: Make, monkeypatch: pytest.MonkeyPatch, name: str, hangs: bool
) -> None:
    monkeypatch.setattr(main_loop, "END_S", 0.1)
    release = threading.Event()

    def fail() -> None:
        if hangs:
            release.wait(PATIENCE_S)
        else:
            raise RuntimeError("boom")

    def open_with_fault(config: StationConfig) -> Devices:
        devices = open_devices(config)
        assert [thread.name for thread in devices.threads()] == list(TWIN_THREADS)
        thread = next(thread for thread in devices.threads() if thread.name == name)
        thread._work, thread._limit_s = fail, 0.1
        return devices

    bench = start(make_config(), ready=False, open_backend=open_with_fault)
    trouble = bench.until(Trouble)
    release.set()
    bench.thread.join(PATIENCE_S)
    for thread in threading.enumerate():
        if thread.name == "closing":
            thread.join(PATIENCE_S)
    assert trouble.code == "thread-lost"
    what = "hangs for" if hangs else "has ended (RuntimeError: boom)"
    assert f"In the acquisition process: Thread {name!r} {what}" in trouble.message


def test_a_ring_of_another_configuration_is_refused(make_config: Make) -> None:
    config = make_config()
    other = make_config(ring={"directory": config.ring.directory, "runs": config.ring.runs + 1})
    here, there = multiprocessing.Pipe()
    with Ring.create(ring_path(other), RingLayout.of(other)) as ring:
        main_loop.run_acquisition(config, ring.path, there)
        trouble = here.recv()
    assert isinstance(trouble, Trouble)
    assert "was created for another configuration" in trouble.message
    assert trouble.action == "Restart the station."
