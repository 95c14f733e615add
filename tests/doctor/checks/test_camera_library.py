"""Check Aravis and PyGObject."""

from __future__ import annotations

import sys

import pytest

from tests.doctor.conftest import assert_problem, only, with_aravis
from vaoi_station.acquisition.cameras.aravis import library
from vaoi_station.config import StationConfig
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.checks import camera_library
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine import Machine


def test_absent_pygobject_is_a_fault(config: StationConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gi", None)
    library.aravis.cache_clear()
    try:
        finding = only(camera_library.aravis(CheckContext(with_aravis(config), Machine(), None)))
    finally:
        library.aravis.cache_clear()
    assert_problem(finding, Level.FAULT, "cannot be used from Python")
    assert "apt install" in finding.action


@pytest.mark.parametrize(
    ("version", "perhaps_usb", "level"),
    [((0, 8, 26), 0, Level.OK), ((0, 8, 26), 1, Level.WARNING), ((0, 8, 30), 1, Level.OK), ((0, 9, 1), 2, Level.OK)],
)
def test_versions_of_aravis(version: tuple[int, int, int], perhaps_usb: int, level: Level) -> None:
    finding = camera_library.judge_version(version, "3.42.2", perhaps_usb)
    assert finding.level is level
    if level is Level.WARNING:
        assert_problem(finding, level, "unreliable with USB3")


def test_simulated_cameras_need_no_library(context: CheckContext) -> None:
    assert only(camera_library.aravis(context)).level is Level.NOT_APPLICABLE
