"""The equations of tiles and their sum, against a few lines of numpy."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.heights.refinement import Normals
from vaoi_station.heights.tile_equations import NOISE_AREA, TileEquations, add_up, edge_weights, weigh_tiles


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


def test_the_variance_of_a_tile_is_at_least_the_low_tenth() -> None:
    found = normals(16, 3)
    found.variance[3] = 0.01
    tiles = weigh_tiles(found, grid_of_tiles(4, 4), 0.15, 0.0)
    variance = np.maximum(found.variance, np.percentile(found.variance, 10)) * NOISE_AREA
    np.testing.assert_allclose(tiles.matrix, found.matrix / variance[:, None, None])
    np.testing.assert_allclose(tiles.vector, found.vector / variance[:, None])
    np.testing.assert_allclose(tiles.noisy, found.noisy / variance)
    assert tiles.unlike_mm == 0
    few = weigh_tiles(found, grid_of_tiles(4, 4), 2.0, 0.0)
    np.testing.assert_allclose(few.noisy, found.noisy / (2 * NOISE_AREA))


def test_differences_beyond_noise_widen_what_tiles_have_in_common() -> None:
    found = normals(16, 3)
    found.variance[5] = 9.0
    tiles = weigh_tiles(found, grid_of_tiles(4, 4), 0.15, 0.0)
    assert 0 < tiles.unlike_mm < 0.1
    assert tiles.noisy[5] < 0.05 * tiles.noisy[6]


def test_the_sum_has_the_height_that_its_tiles_have() -> None:
    tiles = weigh_tiles(normals(16, 5), grid_of_tiles(4, 4), 0.15, 0.0)
    weight = np.linspace(0.5, 1.0, 16)
    found = add_up(tiles, weight)
    n, b = np.tensordot(weight, tiles.matrix, 1), weight @ tiles.vector
    theta = np.linalg.solve(n + np.diag([1e-9] + [1 / 0.05**2] * 4), b)
    assert found.step_mm == pytest.approx(theta[0])
    assert found.step_mm == pytest.approx(0.02, abs=0.003)
    inflation = n[0, 0] / found.matrix[0, 0]
    assert inflation >= float(weight @ tiles.noisy / n[0, 0])
    np.testing.assert_allclose(found.matrix, n / inflation)
    np.testing.assert_allclose(found.vector, b / inflation)


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
