"""Names of processes for `ps`, `top` and `systemctl status`, without a library (docs/decisions/0014)."""

from __future__ import annotations

import contextlib
import ctypes
import sys
from pathlib import Path

COMM_BYTES = 15
"""Longest name that the kernel keeps for a thread."""
_ARG_START, _ARG_END = 48, 49
"""Fields of /proc/self/stat, counted from 1: the addresses of the process's arguments in its memory (proc(5))."""


def set_process_title(title: str, *, arguments: bool) -> None:
    """Name this process; with `arguments`, its command line is replaced too. Does nothing outside of Linux.

    A spawned process has the arguments `python3 -c from multiprocessing…`, which do not show its purpose. The arguments
    of the station itself name its configuration, so they are not replaced.
    """
    if sys.platform != "linux":
        return
    # The name of the main thread is the name of the process.
    with contextlib.suppress(OSError):
        Path("/proc/self/comm").write_bytes(title.encode()[:COMM_BYTES])
    if arguments:
        with contextlib.suppress(OSError, ValueError, IndexError):
            _replace_arguments(title.encode())


def _replace_arguments(title: bytes) -> None:
    """Overwrite the arguments in the memory of this process, from which the kernel reads them."""
    # The name in field 2 may contain spaces. The fields after its closing bracket do not.
    fields = Path("/proc/self/stat").read_bytes().rpartition(b")")[2].split()
    start, end = int(fields[_ARG_START - 3]), int(fields[_ARG_END - 3])
    # Without permission, both addresses are 0. The interpreter has copied its arguments, so only the kernel reads these
    # bytes.
    if 0 < start < end:
        length = end - start
        # If the arguments do not end with a zero byte, the kernel takes them for a title that continues behind them.
        ctypes.memmove(start, title[: length - 1].ljust(length, b"\0"), length)
