"""The benchmark of mosaics measures what it says."""

from __future__ import annotations

from vaoi_station.benchmarks.benchmark_board import BenchmarkBoard
from vaoi_station.benchmarks.mosaic_speed import measure_mosaic


def test_figures_of_a_small_board(small_board: BenchmarkBoard) -> None:
    figures = measure_mosaic(small_board, repetitions=1)
    assert figures.megapixels > 0
    assert 0 < figures.tile_ms_p50 <= figures.tile_ms_p95
    assert figures.plan_ms > 0
    assert figures.mosaic_ratio_to_warp > 0
    assert figures.document()["material"] == "small"
