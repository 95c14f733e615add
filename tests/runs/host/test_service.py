"""Requests to stop, waits at the start, supervision, messages to systemd."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from vaoi_station.errors import DeviceError, VaoiError
from vaoi_station.runs.host import service as module
from vaoi_station.runs.host.service import (
    PASSING,
    StopRequest,
    Supervisor,
    until_started,
)
from vaoi_station.supervised_thread import SupervisedThread


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_wait_with_its_name(number: signal.Signals) -> None:
    with StopRequest() as stop:
        os.kill(os.getpid(), number)
        assert stop.wait() == number.name


AT_ANY_MOMENT = """
import random, signal
from vaoi_station.runs.host import service as stopping

stopping._SIGNALS = (signal.SIGALRM,)  # the one the kernel sends on a timer, between any two instructions
chance = random.Random(1)
for _ in range(20_000):
    with stopping.StopRequest() as stop:
        signal.setitimer(signal.ITIMER_REAL, chance.uniform(2e-6, 2e-5))
        assert stop.wait() == "SIGALRM"
"""


def test_a_signal_at_any_moment_ends_the_wait() -> None:
    """A `threading.Event` set by the handler deadlocks here within a few thousand tries, as does a `SimpleQueue`."""
    subprocess.run([sys.executable, "-c", AT_ANY_MOMENT], timeout=120, check=True)


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FIRST_PAUSE_S", 0.01)


@pytest.mark.parametrize("code", sorted(PASSING))
def test_a_cause_that_passes_is_waited_for_and_reported(code: str) -> None:
    faults, reported = [DeviceError("not yet", code=code) for _ in range(3)], list[VaoiError]()
    waiting = faults.copy()

    def start() -> str:
        if waiting:
            raise waiting.pop(0)
        return "started"

    with StopRequest() as stop:
        assert until_started(stop, start, reported.append) == "started"
    assert reported == faults


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
