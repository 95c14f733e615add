"""What Dask loads first in each worker process of this machine."""

from __future__ import annotations

import signal

from distributed import Worker


def dask_setup(_: Worker) -> None:
    """Ignore Ctrl-C, which a terminal sends to all processes: the command that started the worker ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
