"""How every process of the station begins: who may end it, where its log goes, what becomes of its memory."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager

from vaoi_station.runs.host.logs import configure_logging

_TUNABLES = "GLIBC_TUNABLES"
_MEMORY = {"hugetlb": 1, "trim_threshold": 512 << 20, "mmap_threshold": 32 << 20}
"""Of the GNU C library's malloc: ask for large pages, keep so many bytes, take arrays up to that size from them."""
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def set_up_process(one_thread: bool) -> None:
    """Leave signals to the station, which ends its processes in order; log to where the station logs.

    A terminal sends Ctrl-C, and systemd SIGTERM, to every process of a group: only the station acts on
    them. A child ends when it is told to, or when its pipe ends because the station is gone.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if one_thread:
        os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    configure_logging()


@contextmanager
def keep_freed_memory() -> Iterator[None]:
    """Processes that are started meanwhile, by whatever thread, keep the memory they give back, in large pages.

    The next board needs it. To have it anew, page by page and cleared, and to look up small pages in a large run's
    arrays takes some ten milliseconds between the last frame and the matrices. Only the GNU C library knows this.
    """
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
