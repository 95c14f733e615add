"""One small board of the twin for all benchmarks."""

from __future__ import annotations

import pytest

from vaoi_station.benchmarks.benchmark_board import BenchmarkBoard, board_from_twin


@pytest.fixture(scope="session")
def small_board() -> BenchmarkBoard:
    return board_from_twin("small")
