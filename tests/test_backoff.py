"""Pauses grow until something has really worked for a while."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from vaoi_station.backoff import Backoff, BackoffPolicy


@dataclass
class Clock:
    now_s: float = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def backoff(clock: Clock) -> Backoff:
    return Backoff(BackoffPolicy(first_s=0.5, longest_s=6.0, proven_s=30.0), clock)


def test_every_failure_doubles_the_pause_up_to_the_longest(backoff: Backoff) -> None:
    assert [backoff.record_failure() for _ in range(6)] == [0.5, 1, 2, 4, 6, 6]
    for _ in range(10_000):
        last_s = backoff.record_failure()
    assert last_s == 6, "after days as after a minute"
    assert backoff.record_failure(60.0) == 60.0, "the cause knows better"


def test_what_dies_as_soon_as_it_works_is_tried_ever_more_slowly(backoff: Backoff, clock: Clock) -> None:
    pauses = []
    for _ in range(5):
        backoff.start_attempt()
        backoff.record_success()
        clock.now_s += 1.0
        backoff.record_success()
        pauses.append(backoff.record_failure())
    assert pauses == [0.5, 1, 2, 4, 6]


def test_what_has_worked_for_a_while_begins_anew(backoff: Backoff, clock: Clock) -> None:
    for _ in range(5):
        backoff.record_failure()
    backoff.record_success()
    clock.now_s += 30.0
    assert backoff.record_failure() == 0.5
    clock.now_s += 1000.0
    assert backoff.record_failure() == 1.0, "being away for long is not working"


def test_it_says_when_the_next_try_comes(backoff: Backoff, clock: Clock) -> None:
    due: list[float | None] = [backoff.due_s]
    assert backoff.remaining_s() == 0
    backoff.record_failure()
    due.append(backoff.due_s)
    clock.now_s += 0.2
    assert backoff.remaining_s() == pytest.approx(0.3)
    clock.now_s += 1.0
    assert backoff.remaining_s() == 0
    backoff.start_attempt()
    due.append(backoff.due_s)
    assert due == [None, 100.5, None]


def test_what_has_changed_is_tried_at_once(backoff: Backoff) -> None:
    for _ in range(5):
        backoff.record_failure()
    backoff.reset()
    assert backoff.remaining_s() == 0
    assert backoff.record_failure() == 0.5
