"""Set-up of a child process: signals, number of threads, log and memory allocator."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager

from vaoi_station.runs.host.logs import configure_logging

_TUNABLES = "GLIBC_TUNABLES"
_MEMORY = {"hugetlb": 1, "trim_threshold": 512 << 20, "mmap_threshold": 32 << 20}
"""Tunables of the GNU C library's malloc: use large pages, keep 512 MiB, allocate arrays below 32 MiB there."""
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def set_up_process(one_thread: bool) -> None:
    """Ignore SIGINT and SIGTERM, limit numerical libraries to one thread if asked, and start the log.

    A child ends by a message from the station, or when its pipe ends because the station has died.
    """
    # A terminal sends Ctrl-C, and systemd SIGTERM, to every process of a group. Only the station acts on them, because
    # it ends its processes in order.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if one_thread:
        os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    configure_logging()


@contextmanager
def keep_freed_memory() -> Iterator[None]:
    """Let processes that start inside the context keep freed memory, in large pages, for the next board.

    Only the GNU C library reads the setting; others ignore it.
    """
    # Memory returned to the system is mapped again page by page and cleared. That, and address translation through
    # small pages, took some ten milliseconds between the last frame and the matrices.
    # The library reads the variable once, at process start, so it must be set in the parent.
    before = os.environ.get(_TUNABLES)
    ours = ":".join(f"glibc.malloc.{key}={value}" for key, value in _MEMORY.items())
    os.environ[_TUNABLES] = f"{before}:{ours}" if before else ours
    try:
        yield
    finally:
        if before is None:
            del os.environ[_TUNABLES]
        else:
            os.environ[_TUNABLES] = before
