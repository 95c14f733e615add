"""Retry a device or process with growing pauses until it has worked for a while.

A successful start alone does not end the growth of the pauses. Otherwise, a process that dies right after its start
would be started again and again without a pause.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

# 2.0 ** n overflows a float near n = 1024; a station that is off for days reaches such counts.
_MAX_DOUBLINGS = 20


@dataclass(frozen=True)
class BackoffPolicy:
    """Rules for the pauses between attempts to start one device or process."""

    first_s: float
    """The first pause; each further failure doubles it."""
    longest_s: float
    """Upper limit of the pause."""
    proven_s: float
    """Working time after which the next failure counts as a first one."""


class Backoff:
    """The failures of one device or process so far. One thread uses it; any thread may read `due_s`."""

    def __init__(self, policy: BackoffPolicy, clock: Callable[[], float] = time.monotonic) -> None:
        self._policy, self._clock = policy, clock
        self._failures = 0
        self._works_since_s: float | None = None
        self.due_s: float | None = None
        """Time of the next attempt, time.monotonic(); None while it works or an attempt is under way."""

    def start_attempt(self) -> None:
        """Record that an attempt is under way."""
        self.due_s = self._works_since_s = None

    def record_success(self) -> None:
        """Record that the device or process works. Further calls change nothing while it works."""
        self.due_s = None
        # Only the first call counts: the working time is measured from the start, not from the latest heartbeat.
        if self._works_since_s is None:
            self._works_since_s = self._clock()

    def record_failure(self, longest_s: float | None = None) -> float:
        """Record a failure; return the pause, s, until the next attempt. `longest_s` replaces the policy's limit."""
        now_s = self._clock()
        # The failure count is kept after a short success, so that a device that fails again at once is retried ever
        # more slowly.
        if self._works_since_s is not None and now_s - self._works_since_s >= self._policy.proven_s:
            self._failures = 0
        self._works_since_s = None
        pause_s = self._policy.first_s * 2.0 ** min(self._failures, _MAX_DOUBLINGS)
        self._failures += 1
        pause_s = min(pause_s, self._policy.longest_s if longest_s is None else longest_s)
        self.due_s = now_s + pause_s
        return pause_s

    def reset(self) -> None:
        """Forget all failures, so that the next attempt is due now. To be called when the cause has changed."""
        self._failures, self._works_since_s, self.due_s = 0, None, self._clock()

    def remaining_s(self) -> float:
        """Return the time until the next attempt, in s; 0 if it is due."""
        return 0.0 if self.due_s is None else max(self.due_s - self._clock(), 0.0)
