"""Every fault of a station.toml is found in one pass."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.doctor.config_check import check_config
from vaoi_station.doctor.finding import Level


def problems(path: Path) -> list[str]:
    return [finding.message for finding in check_config(path) if finding.level is Level.FAULT]


def changed(path: Path, *changes: tuple[str, str]) -> Path:
    text = path.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text)
    return path


def test_a_sound_file_has_no_fault(station_toml: Path) -> None:
    assert problems(station_toml) == []


def test_all_faults_are_found_at_once(station_toml: Path) -> None:
    """Unknown keys, wrong values, rules within and between tables, and files that are absent or unreadable."""
    path = changed(
        station_toml,
        ("workers = 1", 'workers = "two"\ncolour = 1'),
        ("tail_s = 0.48", "tial_s = 0.48\ndebounce_s = -1"),
        ('name = "right"', 'name = "left"\nserial = "A1"'),
        ("exposure_us = 250.0", "exposure_us = 250.0\ngain_db = nan"),
        ("[ring]", "[ring]\nruns = 1"),
        ('"calibration.json"', '"absent.json"'),
        ("[api]", "[controller]\ntrigger_us = 1\norder = ['top']\n[api]"),
    )
    (path.parent / "board-types" / "bad.json").write_text("{")
    found = problems(path)
    for key in (
        "workers: ",
        "colour: is an unknown key",
        "line.tial_s: is an unknown key",
        "line.tail_s: Field required",
        "line.debounce_s: ",
        "cameras.0.gain_db: ",
        "cameras.1: camera 'left' has backend 'simulated', which has no serial",
        "ring.runs: ",
        "controller.trigger_us: ",
        "controller: order names the lights ['top']",
        "bad.json: not valid JSON",
    ):
        assert sum(key in message for message in found) == 1, key


def test_conflicts_between_tables_are_found_beside_faulty_keys(station_toml: Path) -> None:
    path = changed(
        station_toml,
        ("workers = 1", "workers = 0"),
        ('name = "right"', 'name = "left"'),
        ("exposure_us = 250.0", "exposure_us = 2500000.0"),
        ("[simulation]", "[[x]]"),
        ('"calibration.json"', '"absent.json"'),
    )
    found = problems(path)
    for part in ("workers: ", "they must differ", "exposes 2500000.0 us", "needs a table [simulation]", "absent.json"):
        assert sum(part in message for message in found) == 1, part


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("[line]", "[line", "not valid TOML"),
        ("[[cameras]]", "[camera]", "cameras: Field required"),
        ('data = "data"', "data = 7", "data: "),
        ('[simulation]\nscenario = "scenario.toml"', "[simulation]\nscenario = 'none.toml'", "none.toml"),
        ('directory = "shm"', 'directory = "none"', "there is no directory"),
        ('board_types = "board-types"', 'board_types = "none"', "there is no directory"),
        ("trigger_period_s = 0.11", "trigger_period_s = 0.12", "period_s"),
    ],
)
def test_each_kind_of_fault(station_toml: Path, old: str, new: str, part: str) -> None:
    path = changed(station_toml, (old, new))
    if new == "[camera]":  # the second table would be a duplicate
        path.write_text(path.read_text().replace("[[cameras]]", "[camera2]"))
    assert any(part in message for message in problems(path))


def test_an_absent_file_is_a_fault(tmp_path: Path) -> None:
    assert problems(tmp_path / "none.toml") == [f"{tmp_path / 'none.toml'}: there is no such file."]


def test_sections_of_the_wrong_kind_are_faults(tmp_path: Path) -> None:
    (tmp_path / "station.toml").write_text("cameras = 3\nline = []\ncontroller = 'x'\n")
    found = problems(tmp_path / "station.toml")
    for key in ("cameras: ", "line: ", "controller: ", "calibration: Field required", "data: Field required"):
        assert any(key in message for message in found), key
