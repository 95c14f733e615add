"""The acquisition process where a clock cannot be read well at first, or not at all."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from vaoi_station.acquisition.cameras.interface import CameraBack, CameraLost
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.process import main_loop as process
from vaoi_station.acquisition.process.backends import open_devices
from vaoi_station.acquisition.process.messages import Arm, Armed, FireOne, RunFinished, Trouble
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError

Start = Callable[..., Any]
Make = Callable[..., StationConfig]
POOR_S = 2.7e-3
PATIENCE_S = 30.0


def counter() -> threading.Semaphore:
    return threading.Semaphore(0)


@dataclass
class Busy:
    """A computer on which so many readings of the controller's clock have long round trips, and then none."""

    poor: float
    good: threading.Semaphore = field(default_factory=counter)
    """Counts the others."""
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
    return Busy(poor).open


@dataclass
class Loose:
    """Camera 1, whose cable is loose."""

    camera: Any
    is_silent: bool = False
    asked: threading.Semaphore = field(default_factory=counter)
    """Counts readings of its clock while it is silent."""
    news: Any = None

    def start(self, arrivals: Any) -> None:
        self.news = arrivals
        self.camera.start(arrivals)

    def read_clock(self) -> ClockReading:
        if self.is_silent:
            self.asked.release()
            raise DeviceError("camera c1: does not tell its time.", action="Check its cable.")
        reading: ClockReading = self.camera.read_clock()
        return reading

    def is_lost(self) -> None:
        """Its backend notices."""
        error = DeviceError("camera c1: is lost.", action="Check its cable.")
        self.news.put(CameraLost(1, time.monotonic(), "it does not answer", error))

    def is_back(self) -> None:
        self.news.put(CameraBack(1, time.monotonic(), self.camera.read_clock()))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.camera, name)


def test_an_arming_waits_until_the_clocks_are_known(start: Start, make_config: Make) -> None:
    """Those first readings that the process takes before it is ready do not suffice, and three more do not."""
    bench = start(make_config(), open_them=busy(process.FIRST_READINGS + 3))
    bench.grant("one", 0)
    bench.arm()
    assert bench.of(Trouble) == []
    assert bench.until(RunFinished).head.missing == ()


def test_so_does_a_single_pulse(start: Start, make_config: Make) -> None:
    bench = start(make_config(), open_them=busy(process.FIRST_READINGS + 3))
    bench.grant("one", 0)
    bench.send(FireOne())
    assert bench.until(RunFinished).head.missing == ()
    assert bench.of(Trouble) == []


def test_clocks_that_are_never_known_are_told_in_the_end(
    start: Start, make_config: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "CLOCK_PATIENCE_S", 0.3)
    bench = start(make_config(), open_them=busy(10**6))
    bench.grant("one", 0)
    bench.send(Arm(TriggerPlan.of(bench.config.line)))
    trouble = bench.until(Trouble)
    assert trouble.code == "clock-unknown"
    assert "controller: its clock is known to ± 2.7" in trouble.message
    assert bench.of(Armed) == []


def test_disarming_ends_the_waiting(start: Start, make_config: Make) -> None:
    """And it is over: the forgotten arming does not come back when the clocks are known."""
    computer = Busy(math.inf)
    bench = start(make_config(), open_them=computer.open)
    bench.grant("one", 0)
    bench.send(Arm(TriggerPlan.of(bench.config.line)))
    assert [grant.run for grant in bench.disarm().unused] == ["one"]
    computer.poor = 0
    for _ in range(2):  # when the second is taken, the loop has been told of the first
        assert computer.good.acquire(timeout=PATIENCE_S)
    bench.grant("two", 0)
    bench.arm()
    assert bench.until(RunFinished).run == "two"
    assert bench.of(Trouble) == []
    assert len(bench.of(Armed)) == 1


def test_a_clock_of_a_camera_that_is_lost_is_not_complained_of(start: Start, make_config: Make) -> None:
    """That it is lost has been told, and whatever is complained of while the line is being armed ends the arming."""
    computer, cameras = Busy(math.inf), list[Loose]()

    def open_them(config: StationConfig) -> Devices:
        devices = computer.open(config)
        cameras.append(Loose(devices.cameras[1]))
        return replace(devices, cameras=(devices.cameras[0], cameras[0]))

    bench = start(make_config(), open_them=open_them)
    [camera] = cameras
    camera.is_silent = True
    assert bench.until(Trouble).message == "camera c1: does not tell its time."
    camera.is_lost()
    while bench.until(Trouble).message != "camera c1: is lost.":
        continue
    told = len(bench.of(Trouble))
    for _ in range(told):
        assert camera.asked.acquire(timeout=PATIENCE_S)
    bench.grant("one", 0)
    bench.send(Arm(TriggerPlan.of(bench.config.line)))
    for _ in range(3):
        assert camera.asked.acquire(timeout=PATIENCE_S)
    computer.poor = 0
    bench.until(Armed)
    assert len(bench.of(Trouble)) == told
    camera.is_back()
    assert bench.until(Trouble).message == "camera c1: does not tell its time."
