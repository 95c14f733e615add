"""Run all checks: as text, as JSON, beside a running station, and without changing anything."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from vaoi_station import doctor
from vaoi_station.cli import main
from vaoi_station.doctor import runner
from vaoi_station.doctor.finding import Finding, Level
from vaoi_station.doctor.runner import check_config
from vaoi_station.doctor.running_station import CheckContext


@pytest.fixture
def vaoi(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    def run(*arguments: object) -> tuple[object, str]:
        monkeypatch.setattr(sys, "argv", ["vaoi", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, capsys.readouterr().out

    return run


def all_files(directory: Path) -> dict[str, tuple[int, bytes]]:
    """Return all files with their times and contents."""
    files = (path for path in sorted(directory.rglob("*")) if path.is_file())
    return {str(path): (path.stat().st_mtime_ns, path.read_bytes()) for path in files}


def test_the_report_names_every_check_and_changes_nothing(vaoi: Any, station_toml: Path) -> None:
    before = all_files(station_toml.parent)
    code, text = vaoi("doctor", "--config", station_toml)
    assert all_files(station_toml.parent) == before
    for name, _ in (*runner.MACHINE_CHECKS, *runner.STATION_CHECKS):
        assert f" {name} " in text
    assert "station 'doctor-test': 0 faults" in text
    assert code in (0, 1)


def test_the_machine_is_checked_without_a_configuration(vaoi: Any, tmp_path: Path) -> None:
    code, text = vaoi("doctor", "--config", tmp_path / "none.toml")
    assert code == 2
    assert "none.toml: there is no such file" in text
    assert " compiled code " in text


def test_a_check_that_raises_does_not_stop_the_others(station_toml: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: CheckContext) -> list[Finding]:
        raise RuntimeError("boom")

    monkeypatch.setattr(runner, "STATION_CHECKS", (("broken", broken), *runner.STATION_CHECKS))
    findings = {f.check: f for f in doctor.run_checks(station_toml).findings}
    assert findings["broken"].level is Level.FAULT
    assert "boom" in findings["broken"].message
    assert set(findings) >= {name for name, _ in runner.STATION_CHECKS}


def problems(path: Path) -> list[str]:
    return [finding.message for finding in check_config(path) if finding.level is Level.FAULT]


def changed(path: Path, *changes: tuple[str, str]) -> Path:
    text = path.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text)
    return path


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
