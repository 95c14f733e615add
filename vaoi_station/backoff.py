"""Trying again, ever more slowly, until something has really worked for a while.

That it could be opened proves little: what dies as soon as it is there would be begun anew without a pause for ever.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

_DOUBLINGS = 20


@dataclass(frozen=True)
class BackoffPolicy:
    """How soon a thing is tried again."""

    first_s: float
    """The first pause; every failure doubles it."""
    longest_s: float
    proven_s: float
    """What has worked for so long has really worked: the next failure is a first one."""


class Backoff:
    """The failures of one thing; used by one thread, `due_s` may be read by any."""

    def __init__(self, pace: BackoffPolicy, clock: Callable[[], float] = time.monotonic) -> None:
        self._pace, self._clock = pace, clock
        self._failures = 0
        self._works_since_s: float | None = None
        self.due_s: float | None = None
        """When it is to be tried again, time.monotonic(); None while it works, or is being tried."""

    def start_attempt(self) -> None:
        """It is being tried."""
        self.due_s = self._works_since_s = None

    def record_success(self) -> None:
        """It works, as far as one can tell; harmless when told again."""
        self.due_s = None
        if self._works_since_s is None:
            self._works_since_s = self._clock()

    def record_failure(self, longest_s: float | None = None) -> float:
        """It works no longer, or could not be begun; how long to wait.

        Args:
            longest_s: in place of that of the pace, where the cause tells how soon it may be over.
        """
        now_s = self._clock()
        if self._works_since_s is not None and now_s - self._works_since_s >= self._pace.proven_s:
            self._failures = 0
        self._works_since_s = None
        pause_s = self._pace.first_s * 2.0 ** min(self._failures, _DOUBLINGS)
        self._failures += 1
        pause_s = min(pause_s, self._pace.longest_s if longest_s is None else longest_s)
        self.due_s = now_s + pause_s
        return pause_s

    def reset(self) -> None:
        """Something has changed, so that the failures so far say nothing: it is to be tried now."""
        self._failures, self._works_since_s, self.due_s = 0, None, self._clock()

    def remaining_s(self) -> float:
        """How long to wait until it is to be tried."""
        return 0.0 if self.due_s is None else max(self.due_s - self._clock(), 0.0)
