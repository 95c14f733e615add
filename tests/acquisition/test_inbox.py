"""Tests of the inbox: its time stays behind messages that were not taken, and behind a process that was held up."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest

from vaoi_station.acquisition.process import main_loop
from vaoi_station.acquisition.process import main_loop as inbox_module
from vaoi_station.acquisition.process.main_loop import HELD_UP_S, LONGEST_LAG_S, Inbox
from vaoi_station.acquisition.process.messages import FireOne, RunFinished


class Clock:
    """A clock that a test sets, with the queue that passes this time when it waits."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 100.0
        self.late_s = 0.0
        """Time by which the next wait ends later than it should."""
        monkeypatch.setattr(inbox_module, "monotonic", lambda: self.now_s)
        self.inbox = Inbox()
        real = self.inbox.messages
        clock = self

        class Waiting:
            def put(self, message: object) -> None:
                real.put(message)

            def empty(self) -> bool:
                return real.empty()

            def get(self, timeout: float) -> Any:
                clock.now_s += (timeout if real.empty() else 0.0) + clock.late_s
                clock.late_s = 0.0
                return real.get_nowait()

        self.inbox.messages = Waiting()  # type: ignore[assignment]

    def take(self, after_s: float = 0.0) -> Any:
        return self.inbox.take(self.now_s + after_s)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def test_its_time_is_the_end_of_a_wait_in_which_nothing_came(clock: Clock) -> None:
    assert clock.take(after_s=0.5) is None
    assert clock.inbox.taken_until_s == clock.now_s == 100.5


def test_its_time_stays_until_the_last_message_was_taken(clock: Clock) -> None:
    clock.inbox.messages.put("first")
    clock.inbox.messages.put("second")
    clock.now_s += HELD_UP_S / 2
    assert clock.take() == "first"
    assert clock.inbox.taken_until_s == 100.0
    assert clock.take() == "second"
    assert clock.inbox.taken_until_s == clock.now_s


def test_a_wait_that_ends_late_is_followed_by_one_for_threads_that_were_held_up_too(clock: Clock) -> None:
    clock.late_s = 0.7
    assert clock.take(after_s=0.2) is None
    assert clock.inbox.taken_until_s == 100.0
    assert clock.take() is None
    assert clock.inbox.taken_until_s == clock.now_s == pytest.approx(100.9 + HELD_UP_S)


def test_a_message_that_took_long_counts_as_being_held_up(clock: Clock) -> None:
    clock.now_s += 0.7
    assert clock.take() is None
    assert clock.now_s == pytest.approx(100.7 + HELD_UP_S)


def test_its_time_lags_by_no_more_than_the_limit(clock: Clock) -> None:
    for n in range(3):
        clock.inbox.messages.put(n)
    clock.now_s += 10.0
    assert clock.take() == 0
    assert clock.inbox.taken_until_s == clock.now_s - LONGEST_LAG_S


def test_frames_that_came_while_the_process_was_held_up_are_not_missing(
    start: Callable[..., Any], make_config: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loop is held up after the end of the pulses, until after the deadline of the frames."""
    held_up = threading.Event()

    def hold_up(loop: Any, _: float) -> None:
        if loop._session.awaits_clocks and not held_up.is_set():
            held_up.set()
            threading.Event().wait(1.0)

    monkeypatch.setattr(main_loop._MainLoop, "_disarm_when_due", hold_up)
    bench = start(make_config())
    bench.grant("one", 0)
    bench.send(FireOne())
    assert bench.until(RunFinished).head.missing == ()
    assert held_up.is_set()
