"""Standard deviations of heights that contain the errors of matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vaoi_station.heights.matrix_errors import BodyEquations, combine, solve_at_sizes

LEAN = np.array([[0.0, 0.5], [0.0, -0.5]])
"""Parallax of two pictures, px per mm."""


def equations(displacement_px: np.ndarray, information: float = 1e5) -> BodyEquations:
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
    bodies = {str(n): equations(g.normal(0, size_px, (2, 2))) for n in range(200)}
    found = np.array(list(combine(bodies, 0.0).values()))
    z = (found[:, 0] - 1) / found[:, 1]
    assert 0.8 < math.sqrt((z**2).mean()) < 1.25
    assert np.median(found[:, 1]) == pytest.approx(size_px * math.sqrt(2), rel=0.4)


def test_the_rows_limit_the_standard_deviation_from_below() -> None:
    bodies = {str(n): equations(np.zeros((2, 2))) for n in range(5)}
    narrow, wide = combine(bodies, 0.0)["0"][1], combine(bodies, 0.08)["0"][1]
    assert narrow < 0.02
    assert wide == pytest.approx(0.04 * math.sqrt(2), rel=0.1)


def test_no_bodies_give_no_heights() -> None:
    assert combine({}, 0.1) == {}


def test_every_size_is_solved_as_by_the_whole_matrix() -> None:
    body, sizes_px = equations(np.array([[0.02, -0.01], [0.03, 0.05]])), np.geomspace(0.004, 0.4, 5)
    expected = []
    for size in sizes_px:
        matrix = body.matrix + np.diag([1e-9] + [(2.0 / size) ** 2] * 4)
        solution, covariance = np.linalg.solve(matrix, body.vector), np.linalg.inv(matrix)
        likelihood = (body.vector @ solution - np.linalg.slogdet(matrix)[1]) / 2 - 4 * math.log(size / 2)
        expected.append((likelihood, solution[0], covariance[0, 0]))
    np.testing.assert_allclose(solve_at_sizes(body.matrix, body.vector, 2.0, sizes_px), expected, rtol=1e-6)


def test_a_matrix_that_is_not_positive_definite_has_no_likelihood() -> None:
    assert solve_at_sizes(-np.eye(3), np.zeros(3), 1.0, np.array([10.0]))[0, 0] == -1e9
