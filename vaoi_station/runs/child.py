"""How every process of the station begins: who may end it, and where its log goes."""

from __future__ import annotations

import os
import signal

from vaoi_station.runs.logs import start_log

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
