"""Which tiles lie on the body, and the probability of its height."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.geometry.transforms import Floats
from vaoi_station.heights.levels import compare_heights, find_levels
from vaoi_station.heights.sweep import Sweep, sweep

HEIGHTS = np.asarray(np.arange(-2, 30) * 0.1, np.float64)
SIZE = np.array([80, 80])
TILES = np.array([(x, y, 10, 10) for y in range(0, 80, 10) for x in range(0, 80, 10)])


def likelihoods(seen_mm: np.ndarray, sigma: float) -> tuple[Floats, Floats]:
    each = np.exp(-(((HEIGHTS[None] - seen_mm[:, None]) / sigma) ** 2) / 2)
    return each, np.exp(-((seen_mm / sigma) ** 2) / 2)


def test_a_fit_that_is_better_than_noise_is_no_evidence() -> None:
    sums = np.full((3, len(HEIGHTS)), 100.0)
    sums[:, 7] = 70.0
    found = Sweep(sums, np.full_like(sums, -500.0), np.full(3, 100), np.ones((3, 2), bool))
    likelihood, _ = compare_heights(found, np.abs(HEIGHTS) < 0.15, 12.0, 0.0)
    assert likelihood.min() > 0.99


def test_a_body_between_leads_is_separated_from_the_board() -> None:
    middle = np.abs(TILES[:, :2] + 5 - 40).max(1)
    seen = np.where(middle < 25, 1.5, 0.0)
    found = find_levels(*likelihoods(seen, 0.1), HEIGHTS, TILES, SIZE, np.zeros(len(HEIGHTS)))
    assert HEIGHTS[found.probability.argmax()] == pytest.approx(1.5)
    assert found.probability[np.abs(HEIGHTS - 1.5) < 0.15].sum() > 0.99
    assert ((found.on_body > 0.5) == (middle < 25)).mean() > 0.9


def test_an_empty_footprint_has_the_level_of_the_board() -> None:
    found = find_levels(*likelihoods(np.zeros(64), 0.1), HEIGHTS, TILES, SIZE, np.zeros(len(HEIGHTS)))
    assert HEIGHTS[found.probability.argmax()] == pytest.approx(0)


MARGIN, SWEPT_TILES = 12, np.array([(4, 4, 10, 10), (20, 10, 10, 10)])
FEET = np.array([[20.0, -150.0], [20.0, 190.0], [20.0, 20.0]])
SHARES = np.linspace(0.0, 0.02, 11)[:, None] * np.ones(3)


def pictures(true_share: float) -> np.ndarray:
    """Three pictures of one plane at a height, on the plane of the board."""
    y, x = np.mgrid[: 40 + 2 * MARGIN, : 50 + 2 * MARGIN] - float(MARGIN)
    out = []
    for foot, gain in zip(FEET, (1.0, 0.6, 1.3), strict=True):
        u, v = x * (1 - true_share) + true_share * foot[0], y * (1 - true_share) + true_share * foot[1]
        out.append(90 + gain * 20 * (np.sin(0.6 * u + 0.2 * v) + np.sin(0.5 * v - 0.3 * u)))
    return np.array(out, np.float32)


def test_groups_saturation_and_borders_limit_what_is_compared() -> None:
    stack = pictures(0.01)
    _, _, freedom, used = sweep(stack, MARGIN, FEET, SHARES, SWEPT_TILES, np.array([0, 0, 1]), 250.0)
    assert used.tolist() == [[True, True, False]] * 2
    assert freedom.tolist() == [97, 97]
    stack[0, MARGIN + 4 : MARGIN + 14, MARGIN + 4 : MARGIN + 14] = 255
    stack[1, :, MARGIN + 20 :] = np.nan
    _, _, freedom, used = sweep(stack, MARGIN, FEET, SHARES, SWEPT_TILES, np.zeros(3, np.int64), 250.0)
    assert used.tolist() == [[False, True, True], [True, False, True]]
