"""Names of processes for `ps`, `top` and `systemctl status`, without a library (docs/decisions/0014)."""

from __future__ import annotations

import contextlib
import ctypes
import sys
from pathlib import Path

COMM_BYTES = 15
"""Longest name that the kernel keeps for a thread."""
_ARG_START, _ARG_END = 48, 49
"""Fields of /proc/self/stat, counted from 1: where the arguments of the process lie in its memory (proc(5))."""


def set_process_title(title: str, *, arguments: bool) -> None:
    """Name this process; with `arguments`, its command line is replaced too. Does nothing outside of Linux.

    A spawned process has the arguments `python3 -c from multiprocessing…`, which say nothing about its purpose. Those
    of the station itself name its configuration, and stay.
    """
    if sys.platform != "linux":
        return
    # The name of the main thread is that of the process.
    with contextlib.suppress(OSError):
        Path("/proc/self/comm").write_bytes(title.encode()[:COMM_BYTES])
    if arguments:
        with contextlib.suppress(OSError, ValueError, IndexError):
            _replace_arguments(title.encode())


def _replace_arguments(title: bytes) -> None:
    """Overwrite the arguments in the memory of this process; the kernel shows what is there."""
    # The name in field 2 may contain spaces; the fields after its bracket do not.
    fields = Path("/proc/self/stat").read_bytes().rpartition(b")")[2].split()
    start, end = int(fields[_ARG_START - 3]), int(fields[_ARG_END - 3])
    # Without permission both are 0. The interpreter has copied its arguments, so these bytes have no other reader.
    if 0 < start < end:
        length = end - start
        # The kernel takes arguments that do not end with a zero byte for a title that goes on behind them.
        ctypes.memmove(start, title[: length - 1].ljust(length, b"\0"), length)
