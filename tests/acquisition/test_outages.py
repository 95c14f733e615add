"""Tests of the record of outages."""

from __future__ import annotations

from vaoi_station.acquisition.outages import Outages


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
