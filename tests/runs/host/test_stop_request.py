"""A request to stop ends the wait, whenever it comes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

import pytest

from vaoi_station.runs.host.stop_request import StopRequest


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


def test_other_signals_do_not_end_the_wait() -> None:
    before = signal.signal(signal.SIGUSR1, lambda *_: None)
    try:
        with StopRequest() as stop:
            os.kill(os.getpid(), signal.SIGUSR1)
            os.kill(os.getpid(), signal.SIGTERM)
            assert stop.wait() == "SIGTERM"
    finally:
        signal.signal(signal.SIGUSR1, before)


def test_repeated_and_late_requests_have_no_effect() -> None:
    with StopRequest() as stop:
        for _ in range(100_000):  # more than a socket holds
            stop.request()
        assert stop.wait() == ""
    stop.request()


def test_handlers_are_restored() -> None:
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


def test_a_signal_at_any_moment_ends_the_wait() -> None:
    """A `threading.Event` set by the handler deadlocks here within a few thousand tries, as does a `SimpleQueue`."""
    subprocess.run([sys.executable, "-c", AT_ANY_MOMENT], timeout=120, check=True)
