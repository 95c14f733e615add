"""Leases end by themselves."""

from __future__ import annotations

import pytest

from vaoi_station.errors import BusyError
from vaoi_station.runs.run.leases import MAX_HOLDERS, OWN, Leases


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def test_a_lease_holds_until_its_time_is_over() -> None:
    clock = Clock()
    leases = Leases(10.0, clock)
    lease = leases.take("r1", "tester 3", "inspection")
    clock.now_s += 9
    assert leases.of("r1") == (lease,)
    assert leases.remaining_s(lease) == 1.0
    clock.now_s += 1
    assert leases.of("r1") == ()
    assert leases.remaining_s(lease) == 0.0
    assert leases.expire() == (lease,)
    assert leases.expire() == ()


def test_the_same_holder_renews() -> None:
    clock = Clock()
    leases = Leases(10.0, clock)
    leases.take("r1", "tester", "inspection")
    clock.now_s += 8
    leases.take("r1", "tester", "inspection, still")
    clock.now_s += 8
    assert [lease.purpose for lease in leases.of("r1")] == ["inspection, still"]
    assert leases.expire() == ()


def test_each_holder_has_its_own_and_a_release_ends_all() -> None:
    leases = Leases(10.0, Clock())
    leases.take("r2", "a", "x")
    leases.take("r1", "a", "x")
    leases.take("r1", "b", "y")
    assert [(lease.run, lease.holder) for lease in leases.all()] == [("r1", "a"), ("r1", "b"), ("r2", "a")]
    leases.end("r1", "a")
    leases.end("r1", "no holder")
    assert [lease.holder for lease in leases.of("r1")] == ["b"]
    leases.end_all("r1")
    assert [lease.run for lease in leases.all()] == ["r2"]


def test_the_number_of_holders_of_a_run_is_limited() -> None:
    leases = Leases(10.0, Clock())
    for k in range(MAX_HOLDERS):
        leases.take("r1", f"tester {k}", "")
    leases.take("r1", "tester 3", "again")
    with pytest.raises(BusyError, match="has 32 holders, which is the limit: tester 0") as refused:
        leases.take("r1", "one more", "")
    assert refused.value.code == "too-many-holders"
    leases.take("r1", f"{OWN}1", "the station's own are not counted")
    leases.take("r2", "one more", "")
    leases.end("r1", "tester 0")
    leases.take("r1", "one more", "")
