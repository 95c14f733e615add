"""Pauses between retries grow until the device has worked for a while."""

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
    assert last_s == 6, "no overflow after days"
    assert backoff.record_failure(60.0) == 60.0, "the given limit replaces the policy's"


def test_a_short_success_does_not_shorten_the_pauses(backoff: Backoff, clock: Clock) -> None:
    pauses = []
    for _ in range(5):
        backoff.start_attempt()
        backoff.record_success()
        clock.now_s += 1.0
        backoff.record_success()
        pauses.append(backoff.record_failure())
    assert pauses == [0.5, 1, 2, 4, 6]


def test_the_time_of_the_next_attempt_is_known(backoff: Backoff, clock: Clock) -> None:
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
