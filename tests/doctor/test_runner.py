"""Run all checks: as text, as JSON, beside a running station, and without changing anything."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from vaoi_station import doctor
from vaoi_station.cli import main
from vaoi_station.config import read_config
from vaoi_station.doctor import runner
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.finding import Finding, Level
from vaoi_station.doctor.machine import Machine
from vaoi_station.station import Station

PAGE = (Path(__file__).parents[2] / "docs" / "engineering" / "doctor.md").read_text(encoding="utf-8")
KEYS = (
    "format", "version", "created", "host", "vaoi_station", "station", "config", "running", "worst", "counts",
    "findings",
)  # fmt: skip
FINDING_KEYS = ("check", "subject", "level", "code", "message", "action", "figures")
"""Keys that programs rely on: keys may be added, never removed."""


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


def test_the_document_has_the_keys_of_its_description(vaoi: Any, station_toml: Path) -> None:
    (station_toml.parent / "calibration.json").unlink()
    code, text = vaoi("doctor", "--config", station_toml, "--json")
    document = json.loads(text)
    assert (code, document["worst"], document["format"], document["version"]) == (2, "fault", "vaoi-doctor", 1)
    assert document["counts"]["fault"] == 1
    assert tuple(document) == KEYS
    assert {tuple(finding) for finding in document["findings"]} == {FINDING_KEYS}
    for key in (*document, *document["findings"][0]):
        assert f"`{key}`" in PAGE
    assert {f["level"] for f in document["findings"]} <= {str(level) for level in Level}


def test_every_check_is_described() -> None:
    for name, _ in (*runner.MACHINE_CHECKS, *runner.STATION_CHECKS):
        assert f"| {name} |" in PAGE


def test_the_machine_is_checked_without_a_configuration(vaoi: Any, tmp_path: Path) -> None:
    code, text = vaoi("doctor", "--config", tmp_path / "none.toml")
    assert code == 2
    assert "none.toml: there is no such file" in text
    assert "Python" in text


def test_a_check_that_raises_does_not_stop_the_others(station_toml: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: CheckContext) -> list[Finding]:
        raise RuntimeError("boom")

    monkeypatch.setattr(runner, "STATION_CHECKS", (("broken", broken), *runner.STATION_CHECKS))
    findings = {f.check: f for f in doctor.run_checks(station_toml).findings}
    assert findings["broken"].level is Level.FAULT
    assert "boom" in findings["broken"].message
    assert set(findings) >= {name for name, _ in runner.STATION_CHECKS}


def test_checks_beside_a_running_station(station_toml: Path) -> None:
    """The station is found by its ring, its state is read by REST, and no process restarts."""
    import socket
    import threading

    from vaoi_station.api import create_app
    from vaoi_station.api.web_server import WebServer, open_listener

    config = read_config(station_toml)
    with open_listener("127.0.0.1", config.api.port, "[api]") as bound, Station(config) as station:
        assert isinstance(bound, socket.socket)
        web = WebServer(create_app(station.coordinator, ("127.0.0.1",)), bound, threading.Event().set)
        web.start()
        before = station.coordinator.snapshot()
        report = doctor.run_checks(station_toml, Machine())
        after = station.coordinator.snapshot()
        web.stop()
    assert report.running is not None
    findings = {(f.check, f.subject): f for f in report.findings}
    assert findings["station", ""].level is Level.OK
    assert {subject for check, subject in findings if check == "cameras"} == {"left", "right"}
    assert [p.pid for p in before.processes] == [p.pid for p in after.processes]
    assert all(p.restarts == 0 for p in after.processes)
    assert doctor.run_checks(station_toml, Machine()).running is None
