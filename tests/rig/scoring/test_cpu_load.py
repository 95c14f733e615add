"""CPU time of processes, summed by role."""

from __future__ import annotations

import os
import time

import pytest

from vaoi_station.rig.scoring import cpu_load
from vaoi_station.rig.scoring.cpu_load import CpuLoadMeter


class Counters:
    """CPU seconds of scripted processes on a scripted clock."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.spent_s: dict[int, float] = {}
        self.now_s = 100.0
        monkeypatch.setattr(cpu_load, "cpu_s", self.read)
        monkeypatch.setattr(time, "monotonic", lambda: self.now_s)

    def read(self, pid: int) -> float:
        if pid not in self.spent_s:
            raise FileNotFoundError(f"/proc/{pid}/stat")
        return self.spent_s[pid]


@pytest.fixture
def counters(monkeypatch: pytest.MonkeyPatch) -> Counters:
    return Counters(monkeypatch)


def test_load_is_cpu_time_since_the_start_divided_by_time(counters: Counters) -> None:
    counters.spent_s = {1: 50.0, 2: 7.0, 3: 8.0}
    meter = CpuLoadMeter({"station": 1, "cameras 0": 2, "cameras 1": 3, "chip": None})
    counters.spent_s = {1: 52.0, 2: 8.0, 3: 10.0}
    counters.now_s += 10.0
    load = meter.read(frames=0)
    assert (load.over_s, load.station, load.cameras, load.chip) == (10.0, 0.2, 0.3, 0.0)


def test_acquisition_is_also_stated_per_frame(counters: Counters) -> None:
    counters.spent_s = {1: 0.0}
    meter = CpuLoadMeter({"acquisition": 1})
    counters.spent_s = {1: 0.3}
    counters.now_s += 6.0
    assert meter.read(frames=200).acquisition_ms_per_frame == pytest.approx(1.5)
    assert meter.read(frames=0).acquisition_ms_per_frame == 0.0


def test_processes_that_have_ended_are_left_out(counters: Counters) -> None:
    counters.spent_s = {1: 5.0}
    meter = CpuLoadMeter({"workers 0": 1, "workers 1": 2})
    counters.spent_s = {2: 9.0}
    counters.now_s += 1.0
    assert meter.read(frames=1).workers == 0.0


def test_this_process_has_used_some_cpu_time() -> None:
    meter = CpuLoadMeter({"rig": os.getpid()})
    assert sum(n * n for n in range(100_000)) > 0
    assert meter.read(frames=0).rig >= 0.0
