"""Normal equations of heights against known displacements."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.heights.refinement import (
    BodyEquations,
    combine,
    normal_equations,
    tile_weights,
)

TILES = np.array([(x, y, 12, 12) for y in (2, 16) for x in (2, 16, 30)])


def shifted(shift_y: float, gain: float, noise: float, seed: int) -> np.ndarray:
    y, x = np.mgrid[:32, :44].astype(np.float64)
    y = y - shift_y
    wave = np.sin(0.5 * x + 0.3 * y) + np.sin(0.45 * y - 0.2 * x) + np.sin(0.4 * x - 0.5 * y)
    ramp = 0.2 * (x - 20) * (seed - 1)
    noisy = 100 + 20 * gain * wave + ramp + np.random.default_rng(seed).normal(0, noise, wave.shape)
    return np.asarray(noisy, np.float32)


@pytest.mark.parametrize("shift", [0.02, -0.1])
def test_a_displacement_along_the_parallax_is_a_height(shift: float) -> None:
    stack = np.array([shifted(0.0, 1.0, 0.3, 1), shifted(shift, 0.5, 0.3, 2)])
    lean = np.zeros((6, 2, 2))
    lean[:, 1, 1] = 1.0
    found = normal_equations(stack, lean, TILES, np.ones((6, 2), np.bool_), np.zeros(2, np.int64))
    each = found.vector[:, 0] / found.matrix[:, 0, 0]
    assert np.median(each) == pytest.approx(shift, abs=0.01)
    # The unknown (δ, d) of the second picture have the same effect along y.
    np.testing.assert_allclose(found.matrix[:, 0, 0], found.matrix[:, 4, 4], rtol=1e-9)
    assert np.median(found.variance) == pytest.approx(0.09, abs=0.2)


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


LEAN = np.array([[0.0, 0.5], [0.0, -0.5]])
"""Parallax of two pictures, px per mm."""


def body_equations(displacement_px: np.ndarray, information: float = 1e5) -> BodyEquations:
    """Equations of a body of 1 mm, seen at 1 mm by two pictures that are displaced."""
    j = np.zeros((4, 5))
    j[:, 0] = LEAN.ravel()
    j[:, 1:] = np.eye(4)
    j = j - np.tile(j.reshape(2, 2, 5).mean(0), (2, 1))
    off = (displacement_px - displacement_px.mean(0)).ravel()
    return BodyEquations(1.0, 0.0, information * j.T @ j, information * j.T @ off, 1.0)


@pytest.mark.parametrize("size_px", [0.01, 0.05])
def test_the_size_of_the_errors_is_found_across_the_parallax(size_px: float) -> None:
    g = np.random.default_rng(3)
    bodies = {str(n): body_equations(g.normal(0, size_px, (2, 2))) for n in range(200)}
    found = np.array(list(combine(bodies, 0.0).values()))
    z = (found[:, 0] - 1) / found[:, 1]
    assert 0.8 < math.sqrt((z**2).mean()) < 1.25
    assert np.median(found[:, 1]) == pytest.approx(size_px * math.sqrt(2), rel=0.4)
