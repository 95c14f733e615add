"""What the kernel says of processes: CPU time spent, memory held."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_UTIME, _STIME = 11, 12
"""Fields of /proc/PID/stat behind the name, which may itself have spaces (proc(5))."""


def cpu_s(pid: int) -> float:
    """CPU time of a process and all its threads, user and system, to 10 ms."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[_UTIME]) + int(fields[_STIME])) / _TICKS_PER_S


def own_memory_bytes(pid: int | str = "self") -> int:
    """Memory that is the process's alone: neither mapped files nor shared memory such as the ring."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("RssAnon:"):
            return int(line.split()[1]) * 1024
    raise OSError(f"/proc/{pid}/status: has no RssAnon; the kernel is older than 4.5")


class Meter:
    """CPU time of several processes, by name, since it was made."""

    def __init__(self, pids: Mapping[str, int]) -> None:
        self._pids = pids
        self._before = {name: cpu_s(pid) for name, pid in pids.items()}

    def read(self) -> dict[str, float]:
        """Seconds by name."""
        return {name: cpu_s(pid) - self._before[name] for name, pid in self._pids.items()}
