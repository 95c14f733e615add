"""Check the kernel's socket buffers."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.doctor.conftest import only, with_aravis
from vaoi_station.config import StationConfig
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.checks import network
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine import Machine


@pytest.mark.parametrize(("granted", "level"), [("212992", Level.WARNING), ("33554432", Level.OK), ("", Level.FAULT)])
def test_socket_buffers(config: StationConfig, tmp_path: Path, granted: str, level: Level) -> None:
    kernel = tmp_path / "proc/sys/net/core"
    kernel.mkdir(parents=True)
    (kernel / "rmem_max").write_text(granted + "\n")
    finding = only(network.socket_buffers(CheckContext(with_aravis(config), Machine(tmp_path), None)))
    assert finding.level is level
    if level is Level.WARNING:
        assert finding.figures == {"rmem_max_bytes": 212992, "needed_bytes": 10 * 1392 * 1040}
        assert "net.core.rmem_max=16777216" in finding.action


def test_simulated_cameras_need_no_socket_buffers(context: CheckContext) -> None:
    assert only(network.socket_buffers(context)).level is Level.NOT_APPLICABLE
