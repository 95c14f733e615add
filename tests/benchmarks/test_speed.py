"""Speed of stitching, rendering and mosaics."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from vaoi_station.benchmarks.boards import BenchmarkBoard
from vaoi_station.benchmarks.speed import SpeedFigures, measure_mosaic, measure_stitching

PUBLISHED = {"stitch_ms_per_frame", "ratio_to_paper_method", "ready_after_last_frame_ms", "render_ratio_to_warp"}


@pytest.fixture(scope="module")
def figures(small_board: BenchmarkBoard) -> SpeedFigures:
    return measure_stitching(small_board, repetitions=1)


def test_all_figures_are_present_and_finite(figures: SpeedFigures) -> None:
    document = asdict(figures)
    assert document.keys() >= PUBLISHED | {"paper_ms_per_frame", "images_per_s", "repetitions", "status", "opencv"}
    for key in PUBLISHED | {"paper_ms_per_frame", "images_per_s"}:
        assert np.isfinite(document[key]), key
        assert document[key] > 0, key
    assert (figures.material, figures.status, figures.paper_failed) == ("small", "ok", "")
    assert (figures.cameras, figures.rows, figures.frame_px) == (2, 6, (640, 480))
    low, high = figures.stitch_spread_ms
    assert low <= figures.stitch_ms_per_frame <= high


def test_board_without_cad_mapping_is_timed_without_component_images(small_board: BenchmarkBoard) -> None:
    """Blank frames show no fiducials, so C is not found and the paper's method has no chain."""
    blank = {key: np.full_like(pixels, 90) for key, pixels in small_board.frames.items() if key[1] < 2}
    head = small_board.head.model_copy(
        update={
            "rows": 2,
            "trigger_times_s": tuple(small_board.head.row_times_s()[:2]),
            "lights": (small_board.head.lights or ())[:2],
        }
    )
    figures = measure_stitching(replace(small_board, head=head, frames=blank), repetitions=1)
    assert (figures.status, figures.cad_sigma_px) == ("failed", None)
    assert (figures.images_per_s, figures.render_ratio_to_warp) == (0, 0)
    assert figures.paper_failed


def test_figures_of_a_small_board(small_board: BenchmarkBoard) -> None:
    figures = measure_mosaic(small_board, repetitions=1)
    assert figures.megapixels > 0
    assert 0 < figures.tile_ms_p50 <= figures.tile_ms_p95
    assert figures.plan_ms > 0
    assert figures.mosaic_ratio_to_warp > 0
    assert figures.material == "small"
