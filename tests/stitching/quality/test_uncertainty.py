"""Predicted uncertainty: of rows, components and single views, against closed forms and numeric derivatives."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry.similarity import apply_similarity
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import Motion, nominal_motion
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, Influence, Problem, to_observations
from vaoi_station.stitching.board.board_plane import board_plane, landmarks
from vaoi_station.stitching.matching.frames import Scene
from vaoi_station.stitching.quality.uncertainty import (
    MODEL_PX,
    PredictedSigma,
    jacobians,
    predict_sigma,
    seam_sigma_px,
    shape_covariances,
)

ROWS = 3
NO_PROBLEM = Problem(np.zeros(1), np.zeros(2), to_observations([], ()), np.zeros(0, dtype=np.int_))
BOARD = {
    "name": "b",
    "y_axis": "down",
    "outline": [[0, 0], [16, 30]],
    "components": [{"ref": f"U{y}", "center": [8, y], "width": 1, "height": 1} for y in (2, 15, 28)],
}


def adjusted(shift_sigma_mm: list[float], angle_sigma: float = 0.0, c_sigma_mm: float = 0.0) -> AdjustmentResult:
    """Make a solution of which only the covariance matters, with independent rows."""
    of_c = (0.0, 0.0, c_sigma_mm**2, c_sigma_mm**2)
    covariance = np.array([np.diag([angle_sigma**2, s**2, s**2, *of_c]) for s in shift_sigma_mm])
    motion = nominal_motion(np.arange(ROWS, dtype=np.float64), np.array([0.0, 8.0]), np.zeros(2))
    nothing, pairs = np.zeros(0), np.zeros((0, 2))
    c = np.array([1.0, 0.0, -8.0, -24.0])
    rest = nothing, pairs, nothing, pairs, 0.02, 1.0, NO_PROBLEM
    return AdjustmentResult(motion, c, nothing, nothing, covariance, *rest)


@pytest.fixture
def scene(workshop: Any) -> Scene:
    camera = workshop.camera()
    return Scene((camera,), tuple((0, j) for j in range(ROWS)), lambda key: pytest.fail("no pixels are needed"))


@pytest.fixture
def plane(scene: Scene) -> Any:
    return board_plane(BoardType.model_validate(BOARD), scene.cameras[0])


def predicted(scene: Scene, plane: Any, found: AdjustmentResult) -> PredictedSigma:
    assert found.similarity is not None
    rows, matrix = found.motion.rows_from_tester, plane.matrix(found.similarity)
    return predict_sigma(
        scene, plane, found, FrameIndex(scene.cameras, rows, tester_from_cad=matrix).views(landmarks(plane)[1])
    )


@pytest.mark.parametrize(
    ("moved_px", "expected_px", "beyond_px"), [(0.4, 0.0, 0.4), (0.4, 0.3, 0.265), (0.3, 0.4, 0.0), (0.09, 0.0, 0.0)]
)
def test_what_noise_does_not_explain_of_the_influence_of_one_place_widens_sigma(
    scene: Scene, plane: Any, moved_px: float, expected_px: float, beyond_px: float
) -> None:
    """Row 2 has σ 0.1 px. Without one place it moves; with another one, by as much as noise explains."""
    found = adjusted([0.0, 0.0, 0.01])
    change, growth = np.zeros((2, ROWS, 7)), np.zeros((2, ROWS, 7, 7))
    change[0, 2, 1], growth[0, 2, 1, 1] = moved_px / 10, (expected_px / 10) ** 2
    change[1, 2, 1], growth[1, 2, 1, 1] = 0.02, 0.02**2
    sigma = predicted(scene, plane, replace(found, influence=Influence(change, growth, np.ones((2, 4), np.bool_), 0)))
    assert sigma.rows_px[:2] == pytest.approx([MODEL_PX] * 2)
    assert sigma.rows_px[2] == pytest.approx(np.hypot(np.hypot(0.1, beyond_px), MODEL_PX), abs=1e-3)


def test_jacobians_match_numeric_derivatives() -> None:
    """Of a detection's residual, by its row, C and the surface."""
    g = np.random.default_rng(4)
    angle, arm, flat, pivot = g.normal(0, 0.1, 3), g.normal(0, 9, (3, 2)), g.normal(0, 9, (3, 2)), np.array([3.0, -2.0])
    shift, c, heights = g.normal(0, 5, 2), g.normal(0, 1, 4), g.normal(0, 0.1, (3, 2, 6))
    found, first = jacobians(angle, arm, flat, heights), np.zeros(1, dtype=np.int_)

    def residual(k: int, unknowns: Any) -> Any:
        board = Motion(unknowns[None, 0], unknowns[None, 1:3], pivot).board(first, arm[k : k + 1] + pivot)[0]
        return board + heights[k] @ unknowns[7:] - apply_similarity(unknowns[3:7], flat[k, None])[0]

    for k in range(3):
        at = np.concatenate([angle[k, None], shift, c, np.zeros(6)])
        j = np.stack([(residual(k, at + d) - residual(k, at - d)) / 2e-6 for d in 1e-6 * np.eye(13)], -1)
        assert found[k] == pytest.approx(j, rel=1e-6, abs=1e-6)


def test_errors_of_the_calibrated_shape_widen_every_view(scene: Scene, plane: Any) -> None:
    """A radial error of 1 px at the corners shifts points near the sides, and with the seams the whole picture."""
    sound = predicted(scene, plane, adjusted([0.0] * 3))
    covariance = np.zeros((9, 9))
    covariance[8, 8] = 1.0
    camera = replace(scene.cameras[0], covariance_px2=covariance)
    assert seam_sigma_px(scene.cameras[0]) == 0
    assert 0.05 < seam_sigma_px(camera) < 1
    corner = np.array([[0.0, 0.0], [camera.width_px - 1.0, camera.height_px - 1.0]])
    found = shape_covariances((camera,), np.zeros(2, dtype=np.int_), corner)
    assert np.trace(found, axis1=1, axis2=2) == pytest.approx(1 + 4 * seam_sigma_px(camera) ** 2, rel=0.5)
    wide = predicted(replace(scene, cameras=(camera,)), plane, adjusted([0.0] * 3))
    assert wide.worst_px is not None
    assert sound.worst_px is not None
    assert wide.worst_px > sound.worst_px + seam_sigma_px(camera)
