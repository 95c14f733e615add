"""Tasks that fail do not end housekeeping, and each failure is published once."""

from __future__ import annotations

import threading

import pytest

from vaoi_station.errors import DeviceError, StateError
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.housekeeping import Housekeeping
from vaoi_station.store import Store

PATIENCE_S = 20.0


class Task:
    """A task that raises `failure`, and counts its calls."""

    def __init__(self) -> None:
        self.failure: Exception | None = None
        self.calls = threading.Semaphore(0)

    def __call__(self) -> None:
        self.calls.release()
        if self.failure is not None:
            raise self.failure

    def wait(self, calls: int = 2) -> None:
        for _ in range(calls):
            assert self.calls.acquire(timeout=PATIENCE_S)


@pytest.mark.parametrize("failure", [DeviceError("The disk is full.", action="Free it."), OSError("odd")])
def test_a_failure_is_published_once_and_the_task_is_called_again(store: Store, failure: Exception) -> None:
    events, task = EventLog(store), Task()
    housekeeping = Housekeeping(events)
    housekeeping.add(task, 0.001, code="chore")
    housekeeping.start()
    task.failure = failure
    task.wait(5)
    assert [event.code for event in events.read(0, PATIENCE_S, 10)] == ["chore"]
    assert len(housekeeping.faults()) == 1
    task.failure = None
    task.wait(30)
    assert housekeeping.faults() == ()
    task.failure = failure
    task.wait(30)
    housekeeping.stop()
    assert [event.code for event in events.read(0, 0.0, 10)] == ["chore", "chore"]


def test_a_closed_database_is_no_failure(store: Store) -> None:
    events, task = EventLog(store), Task()
    task.failure = StateError("closed")
    housekeeping = Housekeeping(events)
    housekeeping.add(task, 0.001, code="chore")
    housekeeping.start()
    task.wait(5)
    housekeeping.stop()
    assert events.read(0, 0.0, 10) == ()


def test_housekeeping_that_was_not_started_can_be_stopped(store: Store) -> None:
    Housekeeping(EventLog(store)).stop()
