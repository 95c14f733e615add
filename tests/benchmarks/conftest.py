"""One small board of the twin for all benchmarks."""

from __future__ import annotations

import pytest

from vaoi_station.benchmarks.boards import BenchmarkBoard, board_from_twin
from vaoi_station.benchmarks.station_pace import PrerenderedRun, prerender
from vaoi_station.simulation import Scenario, read_scenario, scenario_path


@pytest.fixture(scope="session")
def small_board() -> BenchmarkBoard:
    return board_from_twin("small")


@pytest.fixture(scope="session")
def scenario() -> Scenario:
    return read_scenario(scenario_path("small"))


@pytest.fixture(scope="session")
def small_run(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> PrerenderedRun:
    return prerender(scenario, tmp_path_factory.mktemp("prerendered"))
