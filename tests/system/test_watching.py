"""A station on the twin with a camera that is displaced between two boards: it continues and warns."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.config import StationConfig
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.simulation import scenario_path

TIMEOUT_S = 150.0
KNOCK = """
[[faults.knocked]]
camera = 1
from_board = 2
about = "x"
angle_deg = 0.1
"""


def event(coordinator: StationCoordinator, code: str) -> Any:
    """Wait for the first event with a code."""
    after = 0
    while True:
        records = coordinator.events(after, TIMEOUT_S)
        assert records, coordinator.snapshot()
        for record in records:
            if record.code == code:
                return record
        after = records[-1].number


def test_displaced_camera_is_a_warning_after_two_boards(
    twin_config: StationConfig, run_station: Callable[[StationConfig], StationCoordinator], tmp_path: Path
) -> None:
    knocked = tmp_path / "knocked.toml"
    knocked.write_text(scenario_path("small").read_text() + KNOCK)
    assert twin_config.simulation is not None
    simulation = twin_config.simulation.model_copy(update={"scenario": knocked})
    coordinator = run_station(twin_config.model_copy(update={"simulation": simulation, "workers": 1}))
    coordinator.arm("small", runs=5)
    warned = event(coordinator, "calibration-drift")
    runs = sorted(run.id for run in coordinator.runs())
    assert runs.index(warned.run) == 3
    assert runs[2] in warned.message
    (warning,) = coordinator.snapshot().warnings
    assert warning.message.startswith("Camera camera ")
    drifted = [c for c in coordinator.calibration().cameras if c.drift is not None]
    assert [c.drift.since_run for c in drifted if c.drift] == [runs[2]]
    assert [c.drift.size_px for c in drifted if c.drift] == [pytest.approx(9.42, abs=0.1)]
