"""Fixtures: a tiny twin, its station, and the acquisition process as a thread at the end of a pipe."""

from __future__ import annotations

import multiprocessing
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import pytest

from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.process.backends import open_devices
from vaoi_station.acquisition.process.main_loop import run_acquisition
from vaoi_station.acquisition.process.messages import (
    Arm,
    Armed,
    Command,
    Disarm,
    Disarmed,
    Grant,
    Ready,
    Report,
    Shutdown,
)
from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.config import StationConfig
from vaoi_station.files import write_calibration
from vaoi_station.simulation import Twin, read_scenario

R = TypeVar("R")

TINY = """
[array]
cameras = 2
width_px = 96
height_px = 72
px_per_mm = 4.0
working_distance_mm = 200.0
[board]
name = "tiny"
width_mm = 30.0
length_mm = 20.0
density = 0.5
[line]
barrier_mm = -20.0
start_delay_s = 0.12
period_s = 0.05
tail_s = 0.2
longest_board_mm = 22.0
"""

PATIENCE_S = 30.0


class Bench:
    """The station's end of the pipe, and the ring it owns."""

    def __init__(self, config: StationConfig, open_backend: Callable[[StationConfig], Devices] = open_devices) -> None:
        self.config = config
        self.ring = Ring.create(ring_path(config), RingLayout.of(config))
        self.connection, theirs = multiprocessing.Pipe()
        self.reports: list[Report] = []
        self.generations: dict[int, int] = {}
        args = (config, self.ring.path, theirs, open_backend)
        self.thread = threading.Thread(target=run_acquisition, args=args, name="acquisition")
        self.thread.start()

    def send(self, command: Command) -> None:
        self.connection.send(command)

    def grant(self, run: str, bay: int) -> None:
        self.generations[bay] = self.ring.claim(bay)
        self.send(Grant(run, bay))

    def arm(self, runs: int = 0) -> None:
        """Arm with memory for a number of runs: bay n for `run n`."""
        for n in range(runs):
            self.grant(f"run {n}", n)
        self.send(Arm(TriggerPlan.of(self.config.line)))
        self.until(Armed)

    def disarm(self) -> Disarmed:
        self.send(Disarm())
        return self.until(Disarmed)

    def until(self, kind: type[R]) -> R:
        """Collect reports until one of a kind comes; return that one."""
        deadline_s = time.monotonic() + PATIENCE_S
        while self.connection.poll(max(deadline_s - time.monotonic(), 0)):
            report = self.connection.recv()
            self.reports.append(report)
            if isinstance(report, kind):
                return report
        raise AssertionError(f"no {kind.__name__} came, only {[type(r).__name__ for r in self.reports]}")

    def of(self, kind: type[R]) -> list[R]:
        return [r for r in self.reports if isinstance(r, kind)]

    def close(self) -> None:
        try:
            self.send(Shutdown())
        except OSError:
            pass  # the process has ended already
        finally:
            self.connection.close()
        self.thread.join(PATIENCE_S)
        self.ring.close()
        assert not self.thread.is_alive()


@pytest.fixture
def tiny() -> str:
    """Return a scenario to which a test may append faults."""
    return TINY


@pytest.fixture
def slow() -> str:
    """Return a scenario whose board leaves time to act while it passes."""
    return TINY.replace("period_s = 0.05", "period_s = 0.6").replace("tail_s = 0.2", "tail_s = 1.7")


@pytest.fixture
def make_config(tmp_path: Path) -> Callable[..., StationConfig]:
    """Return a function that makes a station for a scenario; keyword arguments change the configuration."""

    def make(scenario_text: str = TINY, interval_s: float = 0.01, **changes: object) -> StationConfig:
        scenario = tmp_path / "scenario.toml"
        scenario.write_text(scenario_text)
        twin = Twin(read_scenario(scenario))
        write_calibration(tmp_path / "calibration.json", twin.calibration)
        content = {
            "name": "test",
            "calibration": tmp_path / "calibration.json",
            "board_types": tmp_path / "types",
            "data": tmp_path / "data",
            "line": twin.line,
            "cameras": [
                {"name": f"c{n}", "width": h.width, "height": h.height, "exposure_us": h.exposure_us}
                for n, h in enumerate(twin.heads)
            ],
            "simulation": {"scenario": scenario, "interval_s": interval_s},
            "ring": {"directory": tmp_path / "shm"},
        }
        (tmp_path / "shm").mkdir(exist_ok=True)
        return StationConfig.model_validate({**content, **changes})

    return make


@pytest.fixture
def start() -> Iterator[Callable[[StationConfig], Bench]]:
    """Return a function that starts the acquisition of a station; at the end all is closed, and checked to be gone."""
    before = set(threading.enumerate())
    benches: list[Bench] = []

    def begin(config: StationConfig, ready: bool = True, **devices: Callable[[StationConfig], Devices]) -> Bench:
        benches.append(Bench(config, **devices))
        if ready:
            benches[-1].until(Ready)
        return benches[-1]

    yield begin
    for bench in benches:
        bench.close()
        assert list(bench.ring.path.parent.iterdir()) == []
    assert set(threading.enumerate()) <= before
