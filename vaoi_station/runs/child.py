"""How every process of the station begins: who may end it, where its log goes, what becomes of its memory."""

from __future__ import annotations

import ctypes
import os
import signal

from vaoi_station.runs.logs import start_log

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Numbers of parameters in malloc.h of the GNU C library."""
_KEPT_BYTES, _LARGEST_BYTES = 512 << 20, 32 << 20
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def settle_in(one_thread: bool) -> None:
    """Leave signals to the station, which ends its processes in order; log to where the station logs.

    A terminal sends Ctrl-C, and systemd SIGTERM, to every process of a group: only the station acts on
    them. A child ends when it is told to, or when its pipe ends because the station is gone.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if one_thread:
        os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    start_log()


def keep_memory() -> None:
    """What the process gives back stays with it, so that the next board's arrays need not be had anew.

    The kernel hands out memory page by page, cleared: several ms between the last frame and the matrices of a large
    board. Other C libraries than GNU's are left as they are.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)
        mallopt(_MMAP_THRESHOLD, _LARGEST_BYTES)
