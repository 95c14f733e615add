"""Check the kernel's memory limit for USB transfers."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.doctor.conftest import assert_problem, only, with_aravis
from vaoi_station.config import StationConfig
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.checks import usb
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine import Machine


@pytest.mark.parametrize(
    ("granted", "level"),
    [("15", Level.FAULT), ("16", Level.OK), ("0", Level.OK), (None, Level.NOT_APPLICABLE)],
)
def test_usb_memory(config: StationConfig, tmp_path: Path, granted: str | None, level: Level) -> None:
    """Two cameras need 8 MB each; 0 means no limit."""
    if granted is not None:
        parameter = tmp_path / usb.PARAMETER
        parameter.parent.mkdir(parents=True)
        parameter.write_text(granted + "\n")
    finding = only(usb.memory(CheckContext(with_aravis(config, serials=True), Machine(tmp_path), None)))
    assert finding.level is level
    if level is Level.FAULT:
        assert_problem(finding, level, "usbfs_memory_mb is 15, 2 cameras on USB need 16")


def test_cameras_with_addresses_need_no_usb_memory(config: StationConfig) -> None:
    finding = only(usb.memory(CheckContext(with_aravis(config), Machine(), None)))
    assert finding.level is Level.NOT_APPLICABLE
