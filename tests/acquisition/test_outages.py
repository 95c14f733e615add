"""Tests of the record of outages."""

from __future__ import annotations

from vaoi_station.acquisition.clocks import ClockJump
from vaoi_station.acquisition.pairing.conclusion import Outages


def test_an_outage_is_the_cause_from_its_begin_to_its_end() -> None:
    outages = Outages()
    outages.begin(1, 10.0, "no answer")
    assert outages.cause_at(1, 9.9) == ""
    assert outages.cause_at(1, 1e9) == "the camera was lost: no answer"
    assert outages.cause_at(0, 10.5) == ""
    outages.end(1, 12.0)
    outages.begin(1, 20.0, "unplugged")
    outages.end(1, 21.0)
    assert [outages.cause_at(1, s) for s in (11.0, 12.5, 20.5, 21.5)] == [
        "the camera was lost: no answer",
        "",
        "the camera was lost: unplugged",
        "",
    ]


def test_only_the_newest_outages_are_kept() -> None:
    outages = Outages(keep=2)
    for second in range(5):
        outages.begin(0, second, str(second))
        outages.end(0, second + 0.5)
    assert [outages.cause_at(0, second + 0.2) for second in range(5)] == [
        "",
        "",
        "",
        *(f"the camera was lost: {k}" for k in "34"),
    ]


def test_times_between_the_readings_of_a_clock_that_jumped_are_unknown() -> None:
    outages = Outages()
    jump = ClockJump(37.0, 10.0, 10.5)
    outages.add_jump(1, jump)
    assert [outages.jump_between(1, s, s) for s in (9.9, 10.2, 10.6)] == [None, jump, None]
    assert outages.jump_between(1, 9.9, 10.1) is jump
    assert outages.jump_between(0, 10.2, 10.2) is None
    assert [outages.count_ended(1, s) for s in (10.4, 10.5)] == [0, 1], "its clock begins a new epoch"
