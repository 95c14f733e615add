"""Sums of blocks are normal equations, and the prior of the belt is one of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.stitching.adjustment.motion import nominal_motion
from vaoi_station.stitching.adjustment.normal_blocks import Block, belt_blocks, square_roots, sum_blocks, whiten


@given(st.integers(0, 1000))
def test_blocks_add_up_to_the_normal_equations(seed: int) -> None:
    g = np.random.default_rng(seed)
    columns = [g.permutation(7)[:3], g.permutation(7)[:5], np.array([2, 2, 4])]
    blocks = [Block(c, g.normal(size=(6, len(c))), g.normal(size=6)) for c in columns]
    dense, right = np.zeros((18, 7)), np.concatenate([b.b for b in blocks])
    for n, b in enumerate(blocks):
        for k, column in enumerate(b.columns):
            dense[6 * n : 6 * n + 6, column] += b.a[:, k]
    normal, rhs = sum_blocks(blocks, 7)
    np.testing.assert_allclose(normal, dense.T @ dense, atol=1e-12)
    np.testing.assert_allclose(rhs, -dense.T @ right, atol=1e-12)


@given(st.integers(0, 1000))
def test_whitened_squares_are_weighted_squares(seed: int) -> None:
    g = np.random.default_rng(seed)
    half, values = g.normal(size=(5, 2, 2)), g.normal(size=(5, 2))
    information = half @ half.swapaxes(1, 2)
    information[0] = 0
    square = (whiten(square_roots(information), values) ** 2).sum(0)
    np.testing.assert_allclose(square, np.einsum("ki,kij,kj->k", values, information, values), atol=1e-9)


def test_a_belt_at_nominal_velocity_has_no_residual() -> None:
    times, velocity = np.array([0.0, 0.1, 0.25]), np.array([30.0, 40.0])
    blocks = belt_blocks(nominal_motion(times, velocity, np.zeros(2)), times, velocity)
    for block in blocks:
        np.testing.assert_allclose(block.b, 0, atol=1e-12)
    normal, _ = sum_blocks(blocks, 9)
    assert np.linalg.matrix_rank(normal) == 6, "the first row is free"


@pytest.mark.parametrize(
    ("deviation", "sigma"),
    [((0.0, 0.02 * 5 + 0.01, 0.0), (1, 0, 0)), ((0.15, 0.0, 0.0), (0, 1, 0)), ((0.0, 0.0, 0.003), (0, 0, 1))],
)
def test_one_standard_deviation_along_across_and_in_rotation(
    deviation: tuple[float, float, float], sigma: tuple[float, float, float]
) -> None:
    """The belt moves 5 mm along y per step; its second row deviates from that by x, y in mm and an angle."""
    times, velocity = np.array([0.0, 0.1]), np.array([0.0, 50.0])
    motion = nominal_motion(times, velocity, np.zeros(2))
    x, y, angle = deviation
    moved = replace(motion, shift=motion.shift + [[0, 0], [x, y]], angle=np.array([0.0, angle]))
    (block,) = belt_blocks(moved, times, velocity)
    assert np.abs(block.b) == pytest.approx(sigma, abs=1e-9)
    change = np.concatenate([[0, 0, 0], [angle, x, y]])
    assert block.a @ change == pytest.approx(block.b, abs=1e-9), "the Jacobian of a linear residual"
