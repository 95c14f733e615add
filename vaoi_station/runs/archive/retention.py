"""Deletion of old runs by number, age, size and verdict, in small steps."""

from __future__ import annotations

import time
from datetime import UTC, datetime

from vaoi_station.config import KeepConfig
from vaoi_station.runs.states.run_ids import assigned_s, earliest_id, utc
from vaoi_station.store.history.retention import RunRetention

BATCH = 10
"""Number of runs that one transaction deletes. The result of a board waits for one such transaction at most."""
MOST_BATCHES = 60
"""Largest number of transactions in one pass. If the clock is set far ahead, at most 600 runs are deleted per
minute."""
SHORT_BYTES, SPARE_BYTES = 1_000_000_000, 100_000_000
"""Free disk space below which room is made within the database, and the room that is made: enough for some 1000
runs."""
DAY_S = 86_400.0
KNOWN_DAYS = 7.0
"""Time in days for which a document is kept although no run refers to it: the next order may."""


class Retention:
    """Deletes old runs as [keep] of station.toml states. `sweep` is one pass."""

    def __init__(self, keep: KeepConfig, kept: RunRetention) -> None:
        self._keep, self._kept = keep, kept

    def sweep(self, now_s: float | None = None) -> int:
        """Delete runs that exceed the limits, in at most `MOST_BATCHES` transactions; return their number.

        `now_s` is the time since 1970; None for the present time.
        """
        now_s = time.time() if now_s is None else now_s
        count = 0
        for _ in range(MOST_BATCHES):
            if not (done := self._step(now_s)):
                break
            count += done
        return count

    def forget_unused(self, now_s: float | None = None) -> None:
        """Forget calibrations, board types and configurations to which no run that is kept refers any more."""
        now_s, kept = time.time() if now_s is None else now_s, self._kept
        known_s = now_s - KNOWN_DAYS * DAY_S
        for _ in range(MOST_BATCHES):
            if not (digests := kept.unused_documents(_utc(known_s), BATCH)):
                break
            kept.forget_documents(digests).result()
        # A configuration is in force from its start on, and its last day is stored: older than all runs, it is unused.
        oldest = kept.oldest_run()
        first_s = now_s if oldest is None else assigned_s(oldest)
        kept.forget_configurations(_utc(min(first_s, now_s) - KNOWN_DAYS * DAY_S)).result()

    def _step(self, now_s: float) -> int:
        """Delete one batch of runs, and return its number of runs; 0 if no limit is exceeded."""
        keep, kept = self._keep, self._kept
        for doubtful, number, days in (
            (False, keep.results, keep.days),
            (True, keep.doubtful_results, keep.doubtful_days),
        ):
            if runs := kept.surplus(doubtful, number, earliest_id(now_s - days * DAY_S), BATCH):
                kept.forget_details(runs).result()
                return len(runs)
        if runs := kept.old_summaries(keep.runs, earliest_id(now_s - keep.run_days * DAY_S), BATCH):
            kept.forget_runs(runs).result()
            return len(runs)
        return self._shrink() if kept.used_bytes() > keep.database_gb * 1e9 or self._disk_is_short() else 0

    def _disk_is_short(self) -> bool:
        """Return whether the disk is nearly full and the database has too few free pages for the next results."""
        # Whatever has filled the disk, at most SPARE_BYTES of the history are deleted for that reason.
        free = self._kept.disk_free_bytes
        return free is not None and free < SHORT_BYTES and self._kept.spare_bytes() < SPARE_BYTES

    def _shrink(self) -> int:
        """Delete data of the oldest runs to shrink the database: details of ok runs, of others, then summaries."""
        kept = self._kept
        for doubtful in (False, True):
            if runs := kept.surplus(doubtful, 2**40, _ALL, BATCH):
                kept.forget_details(runs).result()
                return len(runs)
        if runs := kept.old_summaries(2**40, _ALL, BATCH):
            kept.forget_runs(runs).result()
        return len(runs)


def _utc(time_s: float) -> str:
    return utc(datetime.fromtimestamp(max(time_s, 0.0), UTC))


_ALL = "~"
"""A text that sorts after every run id."""
