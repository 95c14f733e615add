"""Run `vaoi doctor` on a station with real backends: free devices are checked, a running station's are left alone."""

from __future__ import annotations

import json
import sys
from typing import Any

import pytest

from tests.needs import need_emulator
from tests.processes import run_in_own_network


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The output of `rig_session`."""
    need_emulator()
    directory = tmp_path_factory.mktemp("doctor") / "rig"
    done = run_in_own_network(sys.executable, "-m", "tests.doctor.rig_session", str(directory))
    assert done.returncode == 0, done.stderr
    document: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return document


def found(report: dict[str, Any], check: str) -> dict[str, dict[str, Any]]:
    return {finding["subject"]: finding for finding in report["findings"] if finding["check"] == check}


@pytest.mark.aravis
@pytest.mark.parametrize("when", ["before", "after"])
def test_free_devices_are_checked(reports: dict[str, Any], when: str) -> None:
    report = reports[when]
    assert report["running"] is None
    assert report["counts"]["fault"] == 0, report
    assert list(found(report, "cameras")) == ["camera 0", "camera 1", "lo"]
    assert list(found(report, "controller")) == ["port", "firmware", "limits", "state", "clock"]
    assert {f["level"] for check in ("cameras", "controller") for f in found(report, check).values()} == {"ok"}


@pytest.mark.aravis
def test_devices_of_a_running_station_are_not_opened(reports: dict[str, Any]) -> None:
    report = reports["beside"]
    assert report["running"] is not None
    assert report["counts"]["fault"] == 0, report
    assert found(report, "station")[""]["figures"] == {"state": "idle"}
    cameras = found(report, "cameras")
    assert list(cameras) == ["camera 0", "camera 1"]
    assert all(camera["message"].startswith("connected") for camera in cameras.values())
    assert list(found(report, "controller")) == [""]
    untouched, touched = reports["processes"]
    assert touched == untouched
