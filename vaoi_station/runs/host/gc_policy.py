"""Defer full garbage collections while a board is processed.

A full collection scans every object that the garbage collector tracks. In a station that had filmed boards of 3000
components, it took 60 to 95 ms and usually came while a result was unpacked. No Python thread runs during that time. So
objects that exist at the start are excluded permanently, and full collections run only while no board is processed.
Collections of young objects stay automatic, since they take less than a millisecond.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable

IDLE_S = 10.0
"""Time between full collections while no board is processed."""
LONGEST_S = 60.0
"""Time after which a full collection runs even while boards are processed."""
# The module `gc` cannot switch off generation 2 alone. A threshold that is never reached has the same effect.
_NEVER = 1_000_000_000


class GcPolicy:
    """Runs full garbage collections at chosen times instead of the interpreter's times. Used by one thread."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._last_s = 0.0
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
        """Run a full collection if one is due. `busy` states whether a board is processed."""
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
