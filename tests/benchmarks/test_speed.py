"""Speed of stitching, rendering and mosaics."""

from __future__ import annotations

import pytest

from vaoi_station.benchmarks.boards import BenchmarkBoard
from vaoi_station.benchmarks.speed import SpeedFigures, measure_mosaic, measure_stitching


@pytest.fixture(scope="module")
def figures(small_board: BenchmarkBoard) -> SpeedFigures:
    return measure_stitching(small_board, repetitions=1)


def test_figures_of_a_small_board(small_board: BenchmarkBoard) -> None:
    figures = measure_mosaic(small_board, repetitions=1)
    assert figures.megapixels > 0
    assert 0 < figures.tile_ms_p50 <= figures.tile_ms_p95
    assert figures.plan_ms > 0
    assert figures.mosaic_ratio_to_warp > 0
    assert figures.material == "small"
