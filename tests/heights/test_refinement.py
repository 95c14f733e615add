"""Normal equations of heights against known displacements."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.heights.refinement import (
    BodyEquations,
    Normals,
    TileEquations,
    add_up,
    combine,
    edge_weights,
    normal_equations,
    solve_at_sizes,
    tile_weights,
    weigh_tiles,
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


def grid_of_tiles(columns: int, rows: int) -> np.ndarray:
    return np.array([(x * 12, y * 12, 12, 12) for y in range(rows) for x in range(columns)])


def normals(count: int, unknowns: int, height_mm: float = 0.02) -> Normals:
    """Equations of tiles that all have this height and no displacements, with some noise."""
    random = np.random.default_rng(4)
    slopes = random.normal(0, 20, (count, 60, unknowns))
    truth = np.zeros(unknowns)
    truth[0] = height_mm
    values = slopes @ truth + random.normal(0, 0.5, (count, 60))
    matrix = slopes.swapaxes(1, 2) @ slopes
    vector = (slopes.swapaxes(1, 2) @ values[:, :, None])[:, :, 0]
    return Normals(matrix, 1.1 * matrix[:, 0, 0], vector, random.uniform(0.2, 0.3, count))


def test_differences_beyond_noise_widen_what_tiles_have_in_common() -> None:
    found = normals(16, 3)
    found.variance[5] = 9.0
    tiles = weigh_tiles(found, grid_of_tiles(4, 4), 0.15, 0.0)
    assert 0 < tiles.unlike_mm < 0.1
    assert tiles.noisy[5] < 0.05 * tiles.noisy[6]


def test_tiles_that_disagree_make_the_sum_less_certain() -> None:
    tiles = weigh_tiles(normals(16, 5), grid_of_tiles(4, 4), 0.15, 0.0)
    vector = tiles.vector.copy()
    vector[::2, 0] += 0.1 * tiles.matrix[::2, 0, 0]
    apart = TileEquations(tiles.matrix, vector, tiles.noisy, tiles.unlike_mm)
    weight = np.ones(16)
    assert add_up(apart, weight).matrix[0, 0] < 0.2 * add_up(tiles, weight).matrix[0, 0]


def test_edges_of_a_body_with_texture_are_as_good_as_its_middle() -> None:
    assert edge_weights(grid_of_tiles(4, 4), np.full(16, 500.0), 0.1) == pytest.approx(np.ones(16))


def test_edges_of_a_blank_body_are_worth_the_error_they_have_in_common() -> None:
    tiles = grid_of_tiles(4, 3)
    inner = np.isin(np.arange(12), (5, 6))
    weights = edge_weights(tiles, np.where(inner, 0.0, 1000.0), 0.05)
    assert weights[inner] == pytest.approx([1.0, 1.0])
    worth = float((weights * 1000.0)[~inner].sum())
    assert worth == pytest.approx(1 / (1 / 10_000 + 0.05**2))
    assert edge_weights(grid_of_tiles(4, 2), np.full(8, 10.0), 0.05)[0] == pytest.approx(1 / (1 + 80 * 0.05**2))


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


def test_the_rows_limit_the_standard_deviation_from_below() -> None:
    bodies = {str(n): body_equations(np.zeros((2, 2))) for n in range(5)}
    narrow, wide = combine(bodies, 0.0)["0"][1], combine(bodies, 0.08)["0"][1]
    assert narrow < 0.02
    assert wide == pytest.approx(0.04 * math.sqrt(2), rel=0.1)


def test_no_bodies_give_no_heights() -> None:
    assert combine({}, 0.1) == {}


def test_every_size_is_solved_as_by_the_whole_matrix() -> None:
    body, sizes_px = body_equations(np.array([[0.02, -0.01], [0.03, 0.05]])), np.geomspace(0.004, 0.4, 5)
    expected = []
    for size in sizes_px:
        matrix = body.matrix + np.diag([1e-9] + [(2.0 / size) ** 2] * 4)
        solution, covariance = np.linalg.solve(matrix, body.vector), np.linalg.inv(matrix)
        likelihood = (body.vector @ solution - np.linalg.slogdet(matrix)[1]) / 2 - 4 * math.log(size / 2)
        expected.append((likelihood, solution[0], covariance[0, 0]))
    np.testing.assert_allclose(solve_at_sizes(body.matrix, body.vector, 2.0, sizes_px), expected, rtol=1e-6)


def test_a_matrix_that_is_not_positive_definite_has_no_likelihood() -> None:
    assert solve_at_sizes(-np.eye(3), np.zeros(3), 1.0, np.array([10.0]))[0, 0] == -1e9
