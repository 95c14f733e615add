from __future__ import annotations

from vaoi_station.acquisition.causes import Outages


def test_what_a_camera_misses_while_it_is_away_has_that_cause() -> None:
    outages = Outages()
    outages.lost(1, 10.0, "no answer")
    assert outages.at(1, 9.9) == ""
    assert outages.at(1, 1e9) == "the camera was lost: no answer"
    assert outages.at(0, 10.5) == ""
    outages.back(1, 12.0)
    outages.lost(1, 20.0, "unplugged")
    outages.back(1, 21.0)
    assert [outages.at(1, s) for s in (11.0, 12.5, 20.5, 21.5)] == [
        "the camera was lost: no answer",
        "",
        "the camera was lost: unplugged",
        "",
    ]


def test_only_the_newest_outages_are_remembered() -> None:
    outages = Outages(keep=2)
    for second in range(5):
        outages.lost(0, second, str(second))
        outages.back(0, second + 0.5)
    assert [outages.at(0, second + 0.2) for second in range(5)] == [
        "",
        "",
        "",
        *(f"the camera was lost: {k}" for k in "34"),
    ]
