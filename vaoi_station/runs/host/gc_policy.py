"""When Python looks for garbage that refers to itself: not while a board waits for its matrices.

A full look goes through every object there is. In a station that has filmed boards of 3000 components it took 60 to
95 ms, during which nothing else went on, and it came when it would, mostly while a result was being unpacked. So what
is there at the start is left out for good, and full looks are made when nothing is under way. Looks at what is
young go on by themselves; they take less than a millisecond.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable

IDLE_S = 10.0
"""Between two full looks while nothing is under way."""
LONGEST_S = 60.0
"""A line without a pause is looked through all the same."""
_NEVER = 1_000_000_000
"""Generations that must pass before Python makes a full look by itself."""


class GcPolicy:
    """Full looks at times of our choosing; used by one thread."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._last_s = 0.0
        self._before: tuple[int, int, int] | None = None

    def start(self) -> None:
        """From now on; everything that is there is taken to stay."""
        if self._before is None:
            self._before = gc.get_threshold()
            gc.set_threshold(*self._before[:2], _NEVER)
            self._look()
            gc.freeze()

    def tick(self, busy: bool) -> None:
        """A full look if it is time for one."""
        if self._before is not None and self._clock() - self._last_s >= (LONGEST_S if busy else IDLE_S):
            self._look()

    def stop(self) -> None:
        """As Python would have it."""
        if self._before is not None:
            gc.set_threshold(*self._before)
            gc.unfreeze()
            self._before = None

    def _look(self) -> None:
        gc.collect()
        self._last_s = self._clock()
