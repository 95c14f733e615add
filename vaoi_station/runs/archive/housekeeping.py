"""One thread for work that may wait, and the deletion of old runs by number, age, size and verdict."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from vaoi_station.config import KeepConfig
from vaoi_station.errors import StateError, VaoiError
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.states.run_ids import assigned_s, earliest_id, utc
from vaoi_station.store.retention import RunRetention
from vaoi_station.supervised_thread import SupervisedThread

_log = logging.getLogger(__name__)

FIRST_DELAY_S = 5.0
"""Time from the start to the first call of a task, so that housekeeping does not delay the station's start."""
TASK_LIMIT_S = 600.0
"""Longest time for one call of a task. After this time, the thread counts as hung."""


@dataclass
class _Task:
    code: str
    period_s: float
    work: Callable[[], object]
    due_s: float
    fault: str = ""
    """The failure that was published last; empty if the latest call succeeded."""


class Housekeeping:
    """Calls each task periodically. If a task fails, the failure is published and the task is called again later."""

    def __init__(self, events: EventLog) -> None:
        self._events = events
        self._tasks: list[_Task] = []
        self._stopping = threading.Event()
        self.thread = SupervisedThread(self._run, "housekeeping", TASK_LIMIT_S)

    def add(self, work: Callable[[], object], period_s: float, *, code: str) -> None:
        """Add a task before `start`. `code` is the code of the event by which a failure of the task is published."""
        due_s = time.monotonic() + min(period_s, FIRST_DELAY_S)
        self._tasks.append(_Task(code, period_s, work, due_s))

    def start(self) -> None:
        """Start the thread that calls the tasks."""
        self.thread.start()

    def stop(self) -> None:
        """End the thread after its present task."""
        self.thread.expect_end()
        self._stopping.set()
        if self.thread.is_alive():
            self.thread.join()

    def faults(self) -> tuple[str, ...]:
        """Return the failures of the tasks whose latest call failed."""
        return tuple(task.fault for task in self._tasks if task.fault)

    def _run(self) -> None:
        while True:
            task = min(self._tasks, key=lambda task: task.due_s)
            self.thread.rest()
            if self._stopping.wait(max(task.due_s - time.monotonic(), 0.0)):
                return
            self.thread.beat()
            self._call(task)
            task.due_s = time.monotonic() + task.period_s

    def _call(self, task: _Task) -> None:
        try:
            task.work()
            task.fault = ""
        except StateError:
            return  # The station is stopping.
        except VaoiError as error:
            self._report(task, error.message, error.action)
        except Exception as error:  # noqa: BLE001  the thread must go on: without it the disk would fill up
            _log.warning("housekeeping: %s failed", task.code, exc_info=True)
            self._report(task, f"{type(error).__name__}: {error}.", "Report it to the maintainer.")

    def _report(self, task: _Task, message: str, action: str) -> None:
        if message != task.fault:
            task.fault = message
            self._events.add("trouble", message, code=task.code, action=action)


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
        ok, doubtful, summaries = (
            earliest_id(now_s - days * DAY_S) for days in (keep.days, keep.doubtful_days, keep.run_days)
        )
        if done := self._forget((keep.results, ok), (keep.doubtful_results, doubtful), (keep.runs, summaries)):
            return done
        # Whatever has filled the disk, at most SPARE_BYTES of the history are deleted for that reason.
        free = kept.disk_free_bytes
        short = free is not None and free < SHORT_BYTES and kept.spare_bytes() < SPARE_BYTES
        return self._forget(_ALL, _ALL, _ALL) if short or kept.used_bytes() > keep.database_gb * 1e9 else 0

    def _forget(self, ok: tuple[int, str], doubtful: tuple[int, str], summaries: tuple[int, str]) -> int:
        """Delete the oldest data beyond a number or before an id: details of ok runs, of others, then summaries."""
        kept = self._kept
        for is_doubtful, limits in ((False, ok), (True, doubtful)):
            if runs := kept.surplus(is_doubtful, *limits, BATCH):
                kept.forget_details(runs).result()
                return len(runs)
        if runs := kept.old_summaries(*summaries, BATCH):
            kept.forget_runs(runs).result()
        return len(runs)


def _utc(time_s: float) -> str:
    return utc(datetime.fromtimestamp(max(time_s, 0.0), UTC))


_ALL = 2**40, "~"
"""Limits that the oldest runs exceed: the text sorts after every run id."""
