"""Requests to stop, waits at the start, supervision, messages to systemd."""

from __future__ import annotations

import gc
import os
import signal
import socket
import subprocess
import sys
import threading
import weakref
from collections.abc import Iterator
from pathlib import Path

import pytest

from vaoi_station.errors import DeviceError, InputError, VaoiError
from vaoi_station.runs.host import service as module
from vaoi_station.runs.host.service import (
    PASSING,
    StatusNotice,
    StopRequest,
    Supervisor,
    notify,
    until_started,
)
from vaoi_station.supervised_thread import SupervisedThread


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_wait_with_its_name(number: signal.Signals) -> None:
    with StopRequest() as stop:
        os.kill(os.getpid(), number)
        assert stop.wait() == number.name


def test_a_request_of_a_thread_ends_the_wait() -> None:
    with StopRequest() as stop:
        asking = threading.Thread(target=stop.request)
        asking.start()
        assert stop.wait() == ""
        asking.join()


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


def test_a_cause_that_does_not_pass_ends_the_start_at_once() -> None:
    def start() -> None:
        raise InputError("station.toml: a typing error")

    with StopRequest() as stop, pytest.raises(InputError, match="typing error"):
        until_started(stop, start, lambda _: pytest.fail("nothing to wait for"))


def test_a_request_to_stop_ends_the_wait() -> None:
    def start() -> int:
        raise DeviceError("full", code="storage-full")

    with StopRequest() as stop:
        assert until_started(stop, start, lambda _: stop.request()) is None


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


@pytest.mark.parametrize("abstract", [False, True])
def test_messages_arrive(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, abstract: bool) -> None:
    address = f"@vaoi-test-{tmp_path.name}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind("\0" + address[1:] if abstract else address)
        systemd.settimeout(10)
        monkeypatch.setenv("NOTIFY_SOCKET", address)
        assert notify("READY=1")
        notify("WATCHDOG=1")
        assert systemd.recv(100) == b"READY=1"
        assert systemd.recv(100) == b"WATCHDOG=1"


def test_a_status_is_sent_when_it_changes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    address = str(tmp_path / "notify")
    show = StatusNotice()
    show("not delivered")  # so that it is sent again once systemd listens
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(address)
        systemd.settimeout(10)
        monkeypatch.setenv("NOTIFY_SOCKET", address)
        for status in ("not delivered", "armed", "armed", "idle\nsecond line"):
            show(status)
        notify("STOPPING=1")
        received = [systemd.recv(100) for _ in range(4)]
    assert received == [b"STATUS=not delivered", b"STATUS=armed", b"STATUS=idle", b"STOPPING=1"]
