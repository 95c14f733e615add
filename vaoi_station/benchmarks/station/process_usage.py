"""CPU time and private memory of processes, from /proc (proc(5))."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_UTIME, _STIME = 11, 12
"""Indices of the fields of /proc/PID/stat after the name of the process."""


def cpu_s(pid: int) -> float:
    """Return the CPU time of a process and all its threads, user and system, in steps of one clock tick (10 ms)."""
    # The name stands in parentheses and may contain spaces and parentheses, so fields count from the last one.
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[_UTIME]) + int(fields[_STIME])) / _TICKS_PER_S


def private_memory_bytes(pid: int | str = "self") -> int:
    """Return the anonymous resident memory of a process: without mapped files and shared memory such as the ring."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("RssAnon:"):
            return int(line.split()[1]) * 1024
    raise OSError(f"/proc/{pid}/status: has no RssAnon; the kernel is older than 4.5")


class CpuMeter:
    """CPU time that processes have spent since the meter was created."""

    def __init__(self, pids: Mapping[str, int]) -> None:
        """Start to measure the processes, given by name."""
        self._pids = pids
        self._before = {name: cpu_s(pid) for name, pid in pids.items()}

    def read(self) -> dict[str, float]:
        """Return seconds by name."""
        return {name: cpu_s(pid) - self._before[name] for name, pid in self._pids.items()}
