"""What processes of the station have in common: signals, names, threads of libraries, memory, garbage collection.

A child process imports the module of the function with which it starts, so this module imports little.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vaoi_station.runs.host.logs import configure_logging

if TYPE_CHECKING:
    from vaoi_station.config import StationConfig

_TUNABLES = "GLIBC_TUNABLES"
_MEMORY = {"hugetlb": 1, "trim_threshold": 512 << 20, "mmap_threshold": 32 << 20}
"""Settings of malloc in the GNU C library: large pages, up to 512 MiB of freed memory are kept, and arrays below 32 MiB
come from it."""
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that set the number of threads of numerical libraries."""
COMM_BYTES = 15
"""Longest name that the kernel keeps for a thread."""
_ARG_START, _ARG_END = 48, 49
"""Fields of /proc/self/stat, counted from 1: the addresses of the process's arguments in its memory (proc(5))."""
IDLE_S = 10.0
"""Time between full collections while the station is idle."""
LONGEST_S = 60.0
"""Time after which a full collection runs even if the station is never idle, and between two returns of memory."""
# The module `gc` cannot switch off generation 2 alone. A threshold that is never reached has the same effect.
_NEVER = 1_000_000_000


def set_up_process(one_thread: bool) -> None:
    """Set up a child process: ignore SIGINT and SIGTERM, show its name, and configure its log.

    With `one_thread`, numerical libraries use one thread.
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

    Without it, some ten milliseconds passed between the last frame and the matrices. Only the GNU C library reads the
    setting, once, when a process starts.
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


def set_process_title(title: str, *, arguments: bool) -> None:
    """Name this process for `ps`, `top` and `systemctl status`, without a library (docs/decisions/0014).

    With `arguments`, its command line is replaced too: a spawned process has the arguments `python3 -c from
    multiprocessing…`, which do not show its purpose; those of the station itself name its configuration.
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
    """Overwrite the arguments in the memory of this process, from which only the kernel reads them."""
    # The name in field 2 may contain spaces. The fields after its closing bracket do not.
    fields = Path("/proc/self/stat").read_bytes().rpartition(b")")[2].split()
    start, end = int(fields[_ARG_START - 3]), int(fields[_ARG_END - 3])
    if 0 < start < end:  # without permission, both addresses are 0
        length = end - start
        # If the arguments do not end with a zero byte, the kernel takes them for a title that continues behind them.
        ctypes.memmove(start, title[: length - 1].ljust(length, b"\0"), length)


@contextmanager
def no_collections() -> Iterator[None]:
    """Import and build without garbage collections: what is made then stays, and they would scan it again and again."""
    automatic = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if automatic:
            gc.enable()


class GcPolicy:
    """Runs full garbage collections while no board is processed and no caller fetches pictures. Used by one thread.

    In a station that had filmed boards of 3000 components, a full collection took 60 to 95 ms, in which no Python
    thread runs, and usually came while a result was unpacked. Those of young objects stay automatic. After a
    collection, free memory goes back to the kernel, at most once a minute: the C library keeps a heap for every thread
    with the pages of its busiest moment.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._last_s = self._returned_s = 0.0
        self._before: tuple[int, int, int] | None = None
        self._froze = False

    def start(self) -> None:
        """Turn automatic full collections off, and exclude all present objects from later collections.

        A program that has excluded its objects itself keeps that: nothing is excluded here, nor included by `stop`.
        """
        if self._before is None:
            self._before = gc.get_threshold()
            gc.set_threshold(*self._before[:2], _NEVER)
            # Collect first: `freeze` would otherwise keep present garbage for ever.
            self._collect()
            # `unfreeze` takes no choice of objects: it would also include those that the program has excluded.
            self._froze = not gc.get_freeze_count()
            if self._froze:
                gc.freeze()

    def tick(self, busy: bool) -> None:
        """Run a full collection if one is due. `busy`: a board is processed, or a caller fetches pictures."""
        # On a line without pauses collections must run too: otherwise memory in reference cycles would grow without
        # limit.
        if self._before is not None and self._clock() - self._last_s >= (LONGEST_S if busy else IDLE_S):
            self._collect()

    def stop(self) -> None:
        """Restore the interpreter's own garbage collection."""
        if self._before is not None:
            gc.set_threshold(*self._before)
            if self._froze:
                gc.unfreeze()
            self._before = None

    def _collect(self) -> None:
        gc.collect()
        self._last_s = self._clock()
        if self._last_s - self._returned_s >= LONGEST_S:
            self._returned_s = self._last_s
            return_free_memory()


def return_free_memory() -> None:
    """Return the pages of all heaps that hold nothing to the kernel; it takes 0.3 to 2 ms."""
    # Only the C library of GNU has this function, and only it keeps a heap for every thread.
    if (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)) is not None:
        trim(0)
