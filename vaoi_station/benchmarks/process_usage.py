"""Read the CPU time and the private memory of processes from /proc (manual page proc(5))."""

from __future__ import annotations

import os
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
