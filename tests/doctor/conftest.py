"""A complete station on the small scenario, and helpers to judge findings."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.config import ApiConfig, CameraConfig, StationConfig, read_config
from vaoi_station.doctor.finding import Finding, Level
from vaoi_station.doctor.machine import Machine
from vaoi_station.doctor.running_station import CheckContext
from vaoi_station.files import write_board_type, write_calibration
from vaoi_station.simulation import Twin, read_scenario, scenario_path

UNPRIVILEGED = 65534
STATION = """
name = "doctor-test"
calibration = "calibration.json"
board_types = "board-types"
data = "data"
workers = 1

[line]
conveyor_mm_s = [0.0, 100.0]
barrier_mm = -40.0
start_delay_s = 0.32
trigger_period_s = 0.11
tail_s = 0.48
longest_board_mm = 60.0

[[cameras]]
name = "left"
width = 640
height = 480
exposure_us = 250.0

[[cameras]]
name = "right"
width = 640
height = 480
exposure_us = 250.0

[simulation]
scenario = "scenario.toml"

[ring]
directory = "shm"

[keep]
database_gb = 0.05
recordings_gb = 0.0

[api]
port = {port}
"""


@pytest.fixture(scope="session")
def twin() -> Twin:
    return Twin(read_scenario(scenario_path("small")))


@pytest.fixture
def station_toml(twin: Twin, tmp_path: Path, free_port: int) -> Path:
    """A station.toml on the small scenario, with all files that it names."""
    (tmp_path / "shm").mkdir()
    write_calibration(tmp_path / "calibration.json", twin.calibration)
    write_board_type(tmp_path / "board-types" / "small.json", twin.board_type)
    (tmp_path / "scenario.toml").write_bytes(Path(scenario_path("small")).read_bytes())
    path = tmp_path / "station.toml"
    path.write_text(STATION.replace("{port}", str(free_port)))
    return path


@pytest.fixture
def free_port() -> int:
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@pytest.fixture
def config(station_toml: Path) -> StationConfig:
    return read_config(station_toml)


@pytest.fixture
def context(config: StationConfig) -> CheckContext:
    return CheckContext(config, Machine(), None)


def changed(config: StationConfig, section: str, **fields: Any) -> StationConfig:
    """Return the configuration with other values in one table."""
    part = getattr(config, section).model_copy(update=fields)
    return config.model_copy(update={section: part})


def only(findings: Any) -> Finding:
    """Return the only finding of a check."""
    (finding,) = findings
    assert isinstance(finding, Finding)
    return finding


def assert_problem(finding: Finding, level: Level, *words: str) -> None:
    """Assert a finding's level, the words of its message, and that it proposes an action."""
    assert finding.level is level, finding
    for word in words:
        assert word in finding.message, finding
    assert finding.action


@contextmanager
def without_privileges() -> Iterator[None]:
    """Drop all privileges inside the block; this changes something only for root."""
    if os.geteuid() != 0:
        yield
        return
    groups = os.getgroups()
    os.setgroups([])
    os.setegid(UNPRIVILEGED)
    os.seteuid(UNPRIVILEGED)
    try:
        yield
    finally:
        os.seteuid(0)
        os.setegid(0)
        os.setgroups(groups)


def with_config(context: CheckContext, config: StationConfig) -> CheckContext:
    """Return the context with another configuration."""
    return CheckContext(config, context.machine, context.running)


def at_port(config: StationConfig, port: int) -> StationConfig:
    """Return the configuration with another REST port."""
    return config.model_copy(update={"api": ApiConfig(port=port)})


def with_aravis(config: StationConfig, *, serials: bool = False) -> StationConfig:
    """Return the configuration with cameras of the aravis backend, named by address or by serial number."""
    cameras = [
        CameraConfig.model_validate(
            camera.model_dump()
            | {"backend": "aravis", "width": 1392, "height": 1040}
            | ({"serial": f"S{k}"} if serials else {"address": f"10.0.0.{k}"})
        )
        for k, camera in enumerate(config.cameras)
    ]
    return config.model_copy(update={"cameras": tuple(cameras)})
