"""Deletion of old runs by number, age, size and verdict, in small steps."""

from __future__ import annotations

import time

from vaoi_station.config import KeepConfig
from vaoi_station.runs.states.run_ids import earliest_id
from vaoi_station.store.retention import RunRetention

BATCH = 10
"""Number of runs that one transaction forgets: the result of a board waits for at most one such transaction."""
MOST_BATCHES = 60
"""Most transactions of one pass. A clock that was set far ahead thus deletes at most 600 runs a minute."""
SHORT_BYTES, SPARE_BYTES = 1_000_000_000, 100_000_000
"""Free space of the disk below which room is made within the database, and the room that is made: some 1000 runs."""
DAY_S = 86_400.0


class Retention:
    """Forgets runs as [keep] of station.toml says. `sweep` is one pass."""

    def __init__(self, keep: KeepConfig, kept: RunRetention) -> None:
        self._keep, self._kept = keep, kept

    def sweep(self, now_s: float | None = None) -> int:
        """Forget what exceeds the limits, at most `MOST_BATCHES` transactions; return the number of runs.

        `now_s` is the time since 1970; None for the present time.
        """
        now_s = time.time() if now_s is None else now_s
        count = 0
        for _ in range(MOST_BATCHES):
            if not (done := self._step(now_s)):
                break
            count += done
        return count

    def _step(self, now_s: float) -> int:
        """Forget one batch; return its number of runs, 0 if nothing exceeds the limits."""
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
        """Return whether the disk is nearly full and the database has few free pages for the next results."""
        # Whatever fills the disk, no more than SPARE_BYTES of the history are given up for it.
        free = self._kept.disk_free_bytes
        return free is not None and free < SHORT_BYTES and self._kept.spare_bytes() < SPARE_BYTES

    def _shrink(self) -> int:
        """Forget the oldest runs because the database is too large: details of ok runs, of others, then summaries."""
        kept = self._kept
        for doubtful in (False, True):
            if runs := kept.surplus(doubtful, 2**40, _ALL, BATCH):
                kept.forget_details(runs).result()
                return len(runs)
        if runs := kept.old_summaries(2**40, _ALL, BATCH):
            kept.forget_runs(runs).result()
        return len(runs)


_ALL = "~"
"""Sorts after every run id."""
