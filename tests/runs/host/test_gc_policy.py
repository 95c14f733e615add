"""Garbage that refers to itself goes when nothing is under way."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator

import pytest

from vaoi_station.runs.host.gc_policy import IDLE_S, LONGEST_S, GcPolicy


class Knot:
    """Refers to itself."""

    def __init__(self) -> None:
        self.itself = self


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def policy(clock: Clock) -> Iterator[GcPolicy]:
    policy = GcPolicy(clock)
    policy.start()
    yield policy
    policy.stop()


def old_knot() -> weakref.ref[Knot]:
    """Garbage that only a full look finds."""
    knot = Knot()
    gc.collect(1)
    gc.collect(1)
    return weakref.ref(knot)


def test_a_full_look_waits_until_nothing_is_under_way(policy: GcPolicy, clock: Clock) -> None:
    knot = old_knot()
    clock.now_s += IDLE_S
    policy.tick(busy=True)
    assert knot() is not None
    policy.tick(busy=False)
    assert knot() is None


def test_a_line_without_a_pause_is_looked_through_all_the_same(policy: GcPolicy, clock: Clock) -> None:
    knot = old_knot()
    clock.now_s += LONGEST_S
    policy.tick(busy=True)
    assert knot() is None


def test_python_makes_no_full_look_by_itself(policy: GcPolicy) -> None:
    looks = gc.get_stats()[2]["collections"]
    kept = [[k] for k in range(400_000)]
    assert gc.get_stats()[2]["collections"] == looks
    assert len(kept) == 400_000


def test_afterwards_all_is_as_before() -> None:
    before, frozen = gc.get_threshold(), gc.get_freeze_count()
    policy = GcPolicy()
    policy.start()
    assert gc.get_freeze_count() > frozen
    policy.stop()
    policy.tick(busy=False)
    assert gc.get_threshold() == before
    assert gc.get_freeze_count() == 0
