"""Whole stations, on the digital twin and on recordings of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.config import CameraConfig, ReplayConfig, RingConfig, SimulationConfig, StationConfig
from vaoi_station.files import write_board_type, write_calibration
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage
from vaoi_station.station import Station

TIMEOUT_S = 120.0


@pytest.fixture(scope="session")
def twin() -> Twin:
    return Twin(read_scenario(scenario_path("small")))


@pytest.fixture(scope="session")
def recordings(twin: Twin, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return recordings of two boards of the small scenario."""
    folder = tmp_path_factory.mktemp("recordings")
    for number in (0, 1):
        write_passage(twin.passage(number), folder / f"board{number}")
    return folder / "board0", folder / "board1"


def config_of(twin: Twin, directory: Path, backend: str, **more: Any) -> StationConfig:
    """Return the configuration of a station with the twin's array and line; its files are in `directory`."""
    array = twin.scenario.array
    write_calibration(directory / "calibration.json", twin.calibration)
    write_board_type(directory / "board-types" / f"{twin.board_type.name}.json", twin.board_type)
    (directory / "shm").mkdir(exist_ok=True)
    return StationConfig.model_validate(
        {
            "name": "system-test",
            "calibration": directory / "calibration.json",
            "board_types": directory / "board-types",
            "data": directory / "data",
            "workers": 2,
            "line": twin.line,
            "cameras": [
                CameraConfig(
                    name=f"camera {n}", backend=backend, width=array.width_px, height=array.height_px,
                    exposure_us=array.exposure_us(n),
                )
                for n in range(array.cameras)
            ],
            "controller": {"backend": backend},
            "ring": RingConfig(directory=directory / "shm", runs=3, keep_s=0.1),
            **more,
        }
    )  # fmt: skip


@pytest.fixture
def replay_config(twin: Twin, recordings: tuple[Path, Path], tmp_path: Path) -> Callable[..., StationConfig]:
    def make(**options: Any) -> StationConfig:
        replay = ReplayConfig(recordings=recordings, **options)
        return config_of(twin, tmp_path, "replay", replay=replay)

    return make


@pytest.fixture
def twin_config(twin: Twin, tmp_path: Path) -> StationConfig:
    simulation = SimulationConfig(scenario=scenario_path("small"), interval_s=0.5)
    return config_of(twin, tmp_path, "simulated", simulation=simulation)


@pytest.fixture
def run_station() -> Iterator[Callable[[StationConfig], StationCoordinator]]:
    """Return a function that starts a station and waits until it is idle; stations are stopped after the test."""
    stations: list[Station] = []

    def run(config: StationConfig) -> StationCoordinator:
        station = Station(config)
        stations.append(station)
        station.start()
        until_state(station.coordinator, "idle")
        return station.coordinator

    yield run
    for station in stations:
        station.stop()


def until_state(coordinator: StationCoordinator, state: str) -> None:
    """Wait for a state, woken by the event log."""
    deadline, seen = time.monotonic() + TIMEOUT_S, 0
    while coordinator.snapshot().state != state:
        assert time.monotonic() < deadline, coordinator.snapshot()
        records = coordinator.events(seen, 1.0)
        seen = records[-1].number if records else seen


def film_one(coordinator: StationCoordinator, board_type: str = "small") -> RunDetail:
    """Film one board, and return its run when it has ended."""
    seen, deadline = coordinator.snapshot().last_event, time.monotonic() + TIMEOUT_S
    coordinator.arm(board_type, runs=1)
    while True:
        assert time.monotonic() < deadline, coordinator.snapshot()
        for record in coordinator.events(seen, 1.0):
            seen = record.number
            if record.kind == "run" and record.run and record.state in ("ready", "degraded", "failed"):
                return coordinator.run(record.run)


@pytest.fixture
def wait_state() -> Callable[[StationCoordinator, str], None]:
    return until_state
