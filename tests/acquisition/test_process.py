"""The acquisition process on a busy computer, on which a clock cannot be read well at first."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest

from vaoi_station.acquisition import process
from vaoi_station.acquisition.backends import open_devices
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.messages import Arm, Armed, FireOne, RunFinished, Trouble
from vaoi_station.config import StationConfig

Start = Callable[..., Any]
Make = Callable[..., StationConfig]
POOR_S = 2.7e-3


@dataclass
class Busy:
    """A controller whose first readings have long round trips."""

    controller: Any
    poor: int

    def __post_init__(self) -> None:
        self._count = itertools.count()

    def read_clock(self) -> ClockReading:
        reading: ClockReading = self.controller.read_clock()
        return replace(reading, bound_s=POOR_S) if next(self._count) < self.poor else reading

    def __getattr__(self, name: str) -> Any:
        return getattr(self.controller, name)


def busy(poor: int) -> Callable[[StationConfig], Devices]:
    def open_them(config: StationConfig) -> Devices:
        devices = open_devices(config)
        return replace(devices, controller=Busy(devices.controller, poor))

    return open_them


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
    bench = start(make_config(), open_them=busy(process.FIRST_READINGS + 3))
    bench.grant("one", 0)
    bench.send(Arm(TriggerPlan.of(bench.config.line)))
    assert [grant.run for grant in bench.disarm().unused] == ["one"]
    bench.grant("two", 0)
    bench.arm()
    assert bench.until(RunFinished).run == "two"
    assert bench.of(Trouble) == []
