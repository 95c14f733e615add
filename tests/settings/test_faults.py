"""All faults of a station.toml at once, as `vaoi check-config` prints them (tests/doctor/test_config_check.py)."""

from __future__ import annotations

import tomllib
from pathlib import Path

from vaoi_station.settings.faults import examine

EXAMPLE = (Path(__file__).resolve().parents[2] / "deploy" / "station.toml").read_text(encoding="utf-8")


def test_faults_have_their_places_and_one_does_not_hide_another() -> None:
    data = tomllib.loads(EXAMPLE)
    assert examine(data)[0] == []
    data["workers"], data["cameras"][1]["width"], data["line"]["typo"] = 0, "wide", 1
    data["cameras"][2]["name"] = "left"
    faults, valid = examine(data)
    assert {f.place for f in faults} == {("workers",), ("cameras", 1, "width"), ("line", "typo"), ()}
    assert "names" in str(next(f for f in faults if not f.place))
    assert str(next(f for f in faults if f.place == ("line", "typo"))) == "line.typo: is an unknown key (given: 1)"
    assert valid["name"] == "line-1"
    assert "workers" not in valid


def test_an_unknown_key_comes_with_the_one_that_it_resembles() -> None:
    data = tomllib.loads(EXAMPLE)
    data |= {"wrokers": 3, "colour": 1, "keep": {"day": 5}}
    data["cameras"][1]["exposure"] = 250.0
    data["line"]["expected_boards"] = {}
    faults = {str(fault.place[-1]): fault.text for fault in examine(data)[0]}
    assert faults["wrokers"] == "is an unknown key (given: 3), perhaps 'workers' is meant"
    assert faults["colour"] == "is an unknown key (given: 1)"
    assert faults["day"].endswith("perhaps 'days' is meant")
    assert faults["exposure"].endswith("perhaps 'exposure_us' is meant")
    assert faults["expected_boards"].endswith("perhaps 'expected_board' is meant")
