"""The supervisor feeds the watchdog only while all threads are alive, and reports each fault once."""

from __future__ import annotations

import gc
import threading
import weakref
from collections.abc import Iterator

import pytest

from vaoi_station.runs.host import supervisor as module
from vaoi_station.runs.host.supervisor import Supervisor
from vaoi_station.supervised_thread import SupervisedThread

PATIENCE_S = 10.0


class Watched:
    """A supervisor of one thread, which ends when the test says so."""

    def __init__(self) -> None:
        self.release, self.reported = threading.Event(), threading.Event()
        self.fed = threading.Semaphore(0)
        self.faults: list[str] = []
        self.thread = SupervisedThread(self.release.wait, "work")
        self.supervisor = Supervisor(self.fed.release, self.report)

    def report(self, faults: object) -> None:
        assert isinstance(faults, list)
        self.faults += [str(fault) for fault in faults]
        self.reported.set()


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Iterator[Watched]:
    monkeypatch.setattr(module, "PERIOD_S", 0.02)
    made = Watched()
    made.thread.rest()
    made.thread.start()
    made.supervisor.watch(made.thread)
    made.supervisor.start()
    yield made
    made.release.set()
    made.supervisor.stop()


def test_the_watchdog_is_fed_until_a_thread_ends(watched: Watched) -> None:
    assert watched.fed.acquire(timeout=PATIENCE_S)
    assert watched.supervisor.faults() == ()
    watched.release.set()
    assert watched.reported.wait(PATIENCE_S)
    while watched.fed.acquire(blocking=False):
        continue
    assert not watched.fed.acquire(timeout=0.2), "a station that lost a thread is not alive"
    assert watched.faults == ["Thread 'work' has ended without an error."], "a fault is reported once"
    assert [fault.thread for fault in watched.supervisor.faults()] == ["work"]


def test_a_thread_that_has_ended_on_request_is_not_kept(watched: Watched) -> None:
    watched.thread.expect_end()
    watched.release.set()
    watched.thread.join(PATIENCE_S)
    ended = weakref.ref(watched.thread)
    del watched.thread
    watched.supervisor.watch(SupervisedThread(lambda: None, "another"))
    gc.collect()
    assert ended() is None


def test_the_end_of_the_supervisor_is_a_fault_as_well(watched: Watched) -> None:
    watched.supervisor._alive = lambda: 1 / 0
    watched.supervisor.thread.join(PATIENCE_S)
    assert [fault.thread for fault in watched.supervisor.faults()] == ["supervisor"]


def test_a_supervisor_that_was_stopped_reports_nothing(watched: Watched) -> None:
    watched.supervisor.stop()
    watched.release.set()
    watched.thread.join(PATIENCE_S)
    assert watched.faults == []
