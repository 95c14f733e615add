"""Read the CPU time and the private memory of processes from /proc (manual page proc(5))."""

from __future__ import annotations

import os
import threading
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_UTIME, _STIME = 11, 12
"""Indices of user and system time among the fields of /proc/PID/stat that follow the name of the process."""


def cpu_s(pid: int) -> float:
    """Return the CPU time of a process and all its threads, user and system, in steps of one clock tick (10 ms)."""
    # The name in parentheses may itself contain spaces and parentheses, so fields count from the last parenthesis.
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[_UTIME]) + int(fields[_STIME])) / _TICKS_PER_S


def private_memory_bytes(pid: int | str = "self") -> int:
    """Return the anonymous resident memory of a process. It excludes mapped files and shared memory like the ring.

    Memory that a worker shares with the fork server, because neither has written to it, counts in each of them.
    """
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("RssAnon:"):
            return int(line.split()[1]) * 1024
    raise OSError(f"/proc/{pid}/status: has no RssAnon; the kernel is older than 4.5")


class CpuMeter:
    """Meter of the CPU time that processes spend after its creation."""

    def __init__(self, pids: Mapping[str, int]) -> None:
        """Start to measure; `pids` maps the names of the processes to their ids."""
        self._pids = pids
        self._before = {name: cpu_s(pid) for name, pid in pids.items()}

    def read(self) -> dict[str, float]:
        """Return process name → CPU time in seconds."""
        return {name: cpu_s(pid) - self._before[name] for name, pid in self._pids.items()}


class ThreadMeter:
    """Meter of the CPU time that threads of this process spend after its creation, by their names."""

    def __init__(self, names: Collection[str]) -> None:
        """Start to measure the threads that have one of these names now, and those that begin later."""
        self._names = names
        self._before = self._present()

    def read(self) -> float:
        """Return the CPU time in seconds; what a thread spent that has ended meanwhile is not counted."""
        return sum(ns - self._before.get(thread, 0) for thread, ns in self._present().items()) / 1e9

    def _present(self) -> dict[int, int]:
        """Return the CPU time of each thread by its number in the kernel, ns."""
        found = {}
        for thread in threading.enumerate():
            if thread.name in self._names and thread.native_id is not None:
                with suppress(OSError):  # it has ended in this moment
                    spent = Path(f"/proc/self/task/{thread.native_id}/schedstat").read_text()
                    found[thread.native_id] = int(spent.split()[0])
        return found
