"""One thread for work that may wait: deletion of old data, checks of the database."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from vaoi_station.errors import StateError, VaoiError
from vaoi_station.runs.archive.event_log import EventLog
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
