"""Measure the CPU time of all processes of a rig run."""

from __future__ import annotations

import time
from collections.abc import Mapping

from vaoi_station.benchmarks.process_usage import cpu_s
from vaoi_station.rig.scoring.rig_report import Load


class CpuLoadMeter:
    """Measures CPU time since its construction. Processes that end before `read` are not counted."""

    def __init__(self, pids: Mapping[str, int | None]) -> None:
        """Start to measure. `pids`: name → process id. Names are fields of `Load`, some with a number: `cameras 3`."""
        self._pids = {name: pid for name, pid in pids.items() if pid is not None}
        self._before = {name: spent for name, pid in self._pids.items() if (spent := _spent(pid)) is not None}
        self._since_s = time.monotonic()

    def read(self, frames: int) -> Load:
        """Return the average number of busy CPU cores since the construction. `frames` is the number of good frames."""
        over_s = time.monotonic() - self._since_s
        spent = dict.fromkeys(("station", "acquisition", "workers", "cameras", "chip", "rig"), 0.0)
        for name, before in self._before.items():
            now = _spent(self._pids[name])
            # The counters of a process that has ended are gone, so its CPU time is unknown.
            if now is not None:
                spent[name.split()[0]] += now - before
        cores = {name: round(value / over_s, 3) for name, value in spent.items()}
        per_frame = spent["acquisition"] * 1e3 / frames if frames else 0.0
        return Load(over_s=round(over_s, 1), acquisition_ms_per_frame=round(per_frame, 3), **cores)


def _spent(pid: int) -> float | None:
    try:
        return cpu_s(pid)
    except FileNotFoundError:
        return None
