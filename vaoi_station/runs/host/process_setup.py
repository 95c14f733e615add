"""Set-up of a child process: signals, name, number of threads, log and memory allocator; start of the one that films.

A child process imports the module of the function with which it starts, so this module imports little.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vaoi_station.runs.host.gc_policy import no_collections
from vaoi_station.runs.host.logs import configure_logging
from vaoi_station.runs.host.process_title import set_process_title

if TYPE_CHECKING:
    from vaoi_station.config import StationConfig

_TUNABLES = "GLIBC_TUNABLES"
_MEMORY = {"hugetlb": 1, "trim_threshold": 512 << 20, "mmap_threshold": 32 << 20}
"""Settings of malloc in the GNU C library.

It uses large pages, keeps up to 512 MiB of freed memory, and allocates arrays below 32 MiB from the memory it keeps.
"""
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that set the number of threads of numerical libraries."""


def set_up_process(one_thread: bool) -> None:
    """Set up a child process: ignore SIGINT and SIGTERM, show its name, and configure its log.

    With `one_thread`, numerical libraries use one thread. A child process ends when the station sends it a message to
    end, or when its pipe closes because the station has died.
    """
    # A terminal sends Ctrl-C, and systemd SIGTERM, to every process of a group. Only the station acts on them, because
    # it ends its processes in order.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if one_thread:
        os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    set_process_title(multiprocessing.current_process().name, arguments=True)
    configure_logging()


def acquire(config: StationConfig, ring: str, connection: Connection[Any, Any]) -> None:
    """Run the acquisition process until it ends. The child process starts with this function."""
    set_up_process(one_thread=False)
    # Imported here: camera libraries must not be loaded into the station's own process.
    with no_collections():
        from vaoi_station.acquisition.process.main_loop import run_acquisition

    run_acquisition(config, Path(ring), connection)


@contextmanager
def keep_freed_memory() -> Iterator[None]:
    """Let processes that are started in the context keep freed memory, in large pages, and reuse it for the next board.

    Only the GNU C library reads the setting; other C libraries ignore it.
    """
    # When memory was returned to the system, the system maps and clears it again page by page at the next use. This,
    # and address translation through small pages, took some ten milliseconds between the last frame and the matrices.
    # The C library reads the variable once, when a process starts, so it must be set in the parent process.
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
