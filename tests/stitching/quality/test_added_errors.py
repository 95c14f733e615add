"""Standard deviations of rows and matrices against drawn motions, and the share of a reference in C."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import (
    AdjustmentResult,
    Problem,
    to_observations,
)
from vaoi_station.stitching.quality.uncertainty import (
    largest_sigma,
    matrix_sigmas,
    row_covariances,
)

PIVOT = np.array([3.0, -2.0])
NO_PROBLEM = Problem(np.zeros(1), np.zeros(2), to_observations([], ()), np.zeros(0, dtype=np.int_))
MOTION = Motion(np.array([0.0, 0.3, -0.8]), np.array([[0.0, 0.0], [1.0, -8.0], [-2.0, -17.0]]), PIVOT)


@pytest.fixture
def adjusted() -> AdjustmentResult:
    g = np.random.default_rng(4)
    blocks = np.zeros((3, 3, 3))
    for j in (1, 2):
        spread = g.normal(0, 1, (3, 3)) * ([1e-4], [2e-3], [3e-3])
        blocks[j] = spread @ spread.T
    none, pairs = np.zeros(0), np.zeros((0, 2))
    rest = none, pairs, none, pairs, 0.01, 1.0, NO_PROBLEM
    return AdjustmentResult(MOTION, None, none, np.zeros((2, 0)), blocks, *rest)


def drawn(adjusted: AdjustmentResult, count: int) -> list[Motion]:
    """Random motions with the covariance of the adjustment."""
    g = np.random.default_rng(5)
    rows = np.stack([g.multivariate_normal(np.zeros(3), c, count) for c in adjusted.covariance], 1)
    return [replace(MOTION, angle=MOTION.angle + r[:, 0], shift=MOTION.shift + r[:, 1:]) for r in rows]


def test_matrix_sigmas_match_drawn_motions(adjusted: AdjustmentResult, workshop: Any) -> None:
    cameras = [workshop.camera((2.0, 1.0), tilt=(1e-3, -2e-3)), workshop.camera((16.0, 1.0), angle_rad=0.02)]
    sigmas = matrix_sigmas(cameras, PIVOT, row_covariances(adjusted))
    assert sigmas.shape == (2, 3, 2)
    motions = drawn(adjusted, 2000)
    for i, camera in enumerate(cameras):
        frame = np.array([camera.center_px, (0, 0), (199, 0), (199, 159), (0, 159)])
        for j in (1, 2):
            board = MOTION.board(np.full(5, j), camera.ground(frame))
            px = np.array([camera.project(m.row_from_tester(j)(board)) for m in motions])
            spread = largest_sigma(np.array([np.cov(px[:, k].T) for k in range(5)]))
            assert sigmas[i, j] == pytest.approx([spread[0], spread[1:].max()], rel=0.07)
