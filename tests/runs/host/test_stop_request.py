"""A service is asked to end at whatever moment, and ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

import pytest

from vaoi_station.runs.host.stop_request import StopRequest


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_wait_and_is_named(number: signal.Signals) -> None:
    with StopRequest() as stop:
        os.kill(os.getpid(), number)
        assert stop.wait() == number.name


def test_a_part_that_ends_by_itself_ends_the_wait() -> None:
    with StopRequest() as stop:
        asking = threading.Thread(target=stop.request)
        asking.start()
        assert stop.wait() == ""
        asking.join()


def test_other_signals_are_not_meant() -> None:
    before = signal.signal(signal.SIGUSR1, lambda *_: None)
    try:
        with StopRequest() as stop:
            os.kill(os.getpid(), signal.SIGUSR1)
            os.kill(os.getpid(), signal.SIGTERM)
            assert stop.wait() == "SIGTERM"
    finally:
        signal.signal(signal.SIGUSR1, before)


def test_asking_often_and_too_late_is_harmless() -> None:
    with StopRequest() as stop:
        for _ in range(100_000):  # more than a socket holds
            stop.request()
        assert stop.wait() == ""
    stop.request()


def test_handlers_are_put_back() -> None:
    before = [signal.getsignal(n) for n in (signal.SIGTERM, signal.SIGINT)]
    with StopRequest():
        assert signal.getsignal(signal.SIGTERM) not in before
    assert [signal.getsignal(n) for n in (signal.SIGTERM, signal.SIGINT)] == before
    assert signal.set_wakeup_fd(-1) == -1


AT_ANY_MOMENT = """
import random, signal
from vaoi_station.runs.host import stop_request as stopping

stopping._SIGNALS = (signal.SIGALRM,)  # the one the kernel sends on a timer, between any two instructions
chance = random.Random(1)
for _ in range(20_000):
    with stopping.StopRequest() as stop:
        signal.setitimer(signal.ITIMER_REAL, chance.uniform(2e-6, 2e-5))
        assert stop.wait() == "SIGALRM"
"""


def test_a_signal_at_whatever_moment_of_the_wait_ends_it() -> None:
    """An event set by the handler hangs here within a few thousand tries, and so does a `SimpleQueue`."""
    subprocess.run([sys.executable, "-c", AT_ANY_MOMENT], timeout=120, check=True)
