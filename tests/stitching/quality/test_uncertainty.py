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
    DisplacementArrays,
    PointArrays,
    PredictedSigma,
    RowArrays,
    ViewArrays,
    position_covariances,
    predict_sigma,
    seam_sigma_px,
    shape_covariances,
    surface_sigma_mm,
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


def test_uncertainty_of_c_counts_in_every_row(scene: Scene, plane: Any) -> None:
    sigma = predicted(scene, plane, adjusted([0.0] * 3, c_sigma_mm=0.02))
    assert sigma.rows_px == pytest.approx([np.hypot(0.2, MODEL_PX)] * 3)


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


def test_influence_beside_an_unobserved_unknown_is_computed(scene: Scene, plane: Any) -> None:
    """A huge covariance is singular by rounding; another row keeps the influence of its own."""
    found = adjusted([0.0, 0.0, 0.01])
    found.covariance[1, 1:3, 1:3] = 1e20
    change = np.zeros((1, ROWS, 7))
    change[0, 2, 1] = 0.04
    influence = Influence(change, np.zeros((1, ROWS, 7, 7)), np.ones((1, 4), np.bool_), 0)
    sigma = predicted(scene, plane, replace(found, influence=influence))
    assert sigma.rows_px[1] > 1e9
    assert sigma.rows_px[2] == pytest.approx(np.hypot(0.1, 0.4), abs=0.01)


def test_without_c_rows_have_a_sigma_and_components_have_none(scene: Scene, plane: Any) -> None:
    for board in (None, plane):
        sigma = predict_sigma(scene, board, adjusted([0.0, 0.01, 0.03]), None)
        assert sigma.worst_px is None
        assert sigma.rows_px[2] == pytest.approx(np.hypot(0.3, MODEL_PX))


def test_rows_without_a_component_in_view_have_the_sigma_of_their_motion(scene: Scene, plane: Any) -> None:
    blind = replace(scene, present=((0, 0), (0, 1)))
    sigma = predicted(blind, plane, adjusted([0.0, 0.01, 0.5]))
    assert sigma.rows_px[2] == pytest.approx(np.hypot(5.0, MODEL_PX))
    assert sigma.worst_px == pytest.approx(np.hypot(0.1, MODEL_PX))


def test_position_covariances_match_numeric_derivatives() -> None:
    """Row, C, surface and displacement at once, against numpy and numeric derivatives of a detection's residual."""
    g = np.random.default_rng(4)
    angle, shift, pivot, c = g.normal(0, 0.1, 2), g.normal(0, 5, (2, 2)), np.array([3.0, -2.0]), g.normal(0, 1, 4)
    flat, functions, place, lean = (
        g.normal(0, 9, (3, 2)),
        g.normal(0, 1, (3, 6)),
        g.normal(0, 9, (4, 2)),
        g.normal(0, 0.1, (4, 2)),
    )
    half = g.normal(0, 1, (2, 19, 19))
    half[:, 13:] = half[0, 13:]
    whole = half @ half.swapaxes(1, 2)
    covariance, cross, own = whole[:, :13, :13], whole[:, :13, 13:], whole[0, 13:, 13:]
    camera, by_camera = np.array([0, 1, 0, 1]), g.normal(0, 1, (4, 3, 3))
    row, point = np.array([0, 1, 1, 0]), np.array([2, 0, 1, 1])
    found = position_covariances(
        ViewArrays(row, point, place, lean),
        PointArrays(flat, functions),
        RowArrays(angle, pivot, np.ascontiguousarray(covariance)),
        DisplacementArrays(camera, by_camera, np.ascontiguousarray(cross), np.ascontiguousarray(own)),
    )

    def residual(k: int, unknowns: Any) -> Any:
        motion = Motion(unknowns[None, 0], unknowns[None, 1:3], pivot)
        first = np.zeros(1, dtype=np.int_)
        board = motion.board(first, place[k : k + 1])
        leaning = Motion(angle[row[k], None], shift[:1], pivot).turned(first, lean[k : k + 1])
        return (
            board
            + leaning * (functions[point[k]] @ unknowns[7:])
            - apply_similarity(unknowns[3:7], flat[point[k], None])
        )[0]

    for k in range(4):
        at = np.concatenate([angle[row[k], None], shift[row[k]], c, np.zeros(6)])
        j = np.stack([(residual(k, at + d) - residual(k, at - d)) / 2e-6 for d in 1e-6 * np.eye(13)], -1)
        moved = np.zeros((2, 6))
        moved[:, 3 * camera[k] : 3 * camera[k] + 3] = j[:, :3] @ by_camera[k]
        j = np.concatenate([j, moved], 1)
        assert found[k] == pytest.approx(j @ whole[row[k]] @ j.T, rel=1e-6)


def test_json_has_every_view_with_four_significant_digits() -> None:
    covariance = np.array([[[1.23456e-5, -2.5e-9], [-2.5e-9, 4.0]], [[9.87654e-3, 0.0], [0.0, 1.0]]])
    sigma = PredictedSigma((0.1,), 2.0, ("U1", "U2"), np.array([1, 1]), np.array([[0, 2], [1, 2]]), covariance)
    assert sigma.to_json() == {"U2": [[0, 2, 1.235e-5, -2.5e-9, 4.0], [1, 2, 9.877e-3, 0.0, 1.0]]}
    assert sigma.of_components == {"U2": 2.0}
    assert sigma.views["U2"][1, 2] == pytest.approx(covariance[1])


def test_surface_sigma_is_that_of_the_basis_functions(plane: Any) -> None:
    flat = adjusted([0.0] * ROWS)
    places = np.array([[8.0, 15.0], [0.0, 0.0]])
    assert surface_sigma_mm(plane, flat, places) == pytest.approx([0.0, 0.0])
    whole = np.zeros((ROWS, 13, 13))
    whole[:, 7, 7] = 0.25
    assert surface_sigma_mm(plane, replace(flat, surface_mm=np.zeros(6), covariance=whole), places) == pytest.approx(
        [0.5, 0.5]
    )


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


def test_shift_and_turn_of_a_calibration_are_no_error_of_its_shape(scene: Scene) -> None:
    camera = replace(scene.cameras[0], covariance_px2=np.diag([1.0, 1.0, 1.0, *[0.0] * 6]))
    assert seam_sigma_px(camera) == 0
    assert not shape_covariances((camera,), np.zeros(1, dtype=np.int_), np.zeros((1, 2))).any()
