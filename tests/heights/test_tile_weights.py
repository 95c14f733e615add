"""Weights of tiles: those that most agree with count, those that differ do not."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.heights.tile_weights import tile_weights


def equations(mm: np.ndarray, information: float = 1e4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The equations of tiles at these heights, without other parameters and nearly without noise."""
    matrix = np.full((len(mm), 1, 1), information)
    return matrix, information * mm[:, None], np.full(len(mm), 1e-3 * information)


@given(st.floats(-1, 12), st.integers(3, 40), st.sampled_from([-1.0, 0.5, 3.0]))
def test_a_tile_that_differs_has_no_weight(height_mm: float, count: int, off_mm: float) -> None:
    mm = np.full(count, height_mm)
    mm[-1] += off_mm
    weights = tile_weights(*equations(mm))
    assert (weights[:-1] > 0.9).all()
    assert weights[-1] == 0


def test_tiles_without_texture_have_no_weight() -> None:
    matrix, vector, noisy = equations(np.full(5, 1.0))
    assert not tile_weights(matrix, vector, noisy * 1e5).any()
    assert not tile_weights(-matrix, -vector, noisy).any()
