"""Equations of fiducials agree with their definition and with derivatives by differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.stitching.adjustment.equations import (
    detection_equations,
    detection_sigma_mm,
    fiducial_residuals,
)
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import REFERENCE, FiducialPoints

Array = NDArray[np.float64]
ROWS, POINTS, BASIS = 3, 8, 2
C = np.array([1.0, 0.02, -12.0, -8.0])


def points(which: list[int] | None = None) -> FiducialPoints:
    g = np.random.default_rng(1)
    return FiducialPoints(
        np.arange(POINTS) % ROWS,
        g.normal(0, 20, (POINTS, 2)),
        g.normal(0, 0.02, (POINTS, 2)),
        g.normal(0, 20, (POINTS, 2)),
        np.full(POINTS, 1e-3),
        np.full(POINTS, 20.0),
        np.array(which or [0, 0, 0, 1, 1, 2, 2, 2]),
        np.zeros(POINTS, dtype=np.int_),
    )


def evaluate(unknowns: Array, s: FiducialPoints, basis: Array) -> tuple[Array, Array]:
    """Residuals and Jacobian from rows (φ, sx, sy), C and surface in one vector."""
    rows = unknowns[: 3 * ROWS].reshape(ROWS, 3)
    motion = Motion(np.ascontiguousarray(rows[:, 0]), np.ascontiguousarray(rows[:, 1:]), np.array([3.0, -2.0]))
    return fiducial_residuals(s, motion, unknowns[3 * ROWS : 3 * ROWS + 4], basis, unknowns[3 * ROWS + 4 :])


@pytest.mark.parametrize("surface", [0, BASIS])
def test_the_jacobian_is_the_derivative_of_the_residuals(surface: int) -> None:
    g = np.random.default_rng(2)
    s, basis = points(), g.normal(0, 1, (POINTS, surface))
    # surface at 0: the rotation of the lean, which the Jacobian leaves out, has no effect there
    unknowns = np.concatenate([g.normal(0, 0.05, 3 * ROWS), C, np.zeros(surface)])
    jacobian = evaluate(unknowns, s, basis)[1]
    assert jacobian.shape == (POINTS, 2, 3 + 4 + surface)
    for k, row in enumerate(s.row):
        columns = [*range(3 * row, 3 * row + 3), *range(3 * ROWS, len(unknowns))]
        for n, column in enumerate(columns):
            step = np.zeros(len(unknowns))
            step[column] = 1e-6
            change = (evaluate(unknowns + step, s, basis)[0] - evaluate(unknowns - step, s, basis)[0])[k] / 2e-6
            assert jacobian[k, :, n] == pytest.approx(change, abs=1e-6)


def test_the_mean_of_many_detections_is_never_better_than_their_common_error() -> None:
    for count in (1, 10, 1000):
        s = FiducialPoints(*(np.resize(v, (count, *v.shape[1:])) for v in vars(points([0] * POINTS)).values()))
        assert (detection_sigma_mm(s) / np.sqrt(count) >= 0.004 / 20).all()


def test_an_outlier_among_fiducials_loses_weight_and_one_among_many_points_has_none() -> None:
    s, jacobian, columns = points(), np.ones((POINTS, 2, 7)), np.zeros((POINTS, 7), np.int_)
    residual = np.zeros((POINTS, 2))
    residual[0] = 1.0
    _, a, _ = detection_equations(s, detection_sigma_mm(s), residual, jacobian, columns)
    weight = a[:, 0, 0]
    assert 0 < weight[0] < 0.1 * weight[1]
    many = replace(s, which=np.full(POINTS, REFERENCE))
    assert detection_equations(many, detection_sigma_mm(many), residual, jacobian, columns)[1][0, 0, 0] == 0
