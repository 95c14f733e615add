"""Normal equations of heights against known displacements."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.heights.refinement import normal_equations

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


def test_noise_alone_has_no_information() -> None:
    g = np.random.default_rng(1)
    stack = np.asarray(g.normal(100, 2, (2, 32, 44)), np.float32)
    lean = np.zeros((6, 2, 2))
    lean[:, 1, 1] = 1.0
    found = normal_equations(stack, lean, TILES, np.ones((6, 2), np.bool_), np.zeros(2, np.int64))
    assert abs(found.matrix[:, 0, 0].sum()) < 0.4 * found.noisy.sum()


def test_groups_are_not_compared_with_each_other() -> None:
    stack = np.array([shifted(0.0, 1.0, 0.3, 1), shifted(0.3, 1.0, 0.3, 2)])
    lean = np.ones((6, 2, 2))
    found = normal_equations(stack, lean, TILES, np.ones((6, 2), np.bool_), np.array([0, 1]))
    assert not found.matrix.any()
    assert not found.variance.any()
