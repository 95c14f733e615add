"""Defer full garbage collections while a board is processed or callers fetch pictures.

A full collection scans every object that the garbage collector tracks. In a station that had filmed boards of 3000
components, it took 60 to 95 ms and usually came while a result was unpacked. No Python thread runs during that time. So
objects that exist at the start are excluded permanently, and full collections run only while the station is idle.
Collections of young objects stay automatic, since they take less than a millisecond.

After a collection, free memory goes back to the kernel, at most once a minute. The C library keeps a heap for every
thread, and each keeps the pages of its busiest moment: over thousands of boards such moments come to every thread, and
the process would grow by what no thread uses.
"""

from __future__ import annotations

import ctypes
import gc
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

IDLE_S = 10.0
"""Time between full collections while the station is idle."""
LONGEST_S = 60.0
"""Time after which a full collection runs even if the station is never idle, and between two returns of memory."""
# The module `gc` cannot switch off generation 2 alone. A threshold that is never reached has the same effect.
_NEVER = 1_000_000_000


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
    """Runs full garbage collections at chosen times instead of the interpreter's times. Used by one thread."""

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
