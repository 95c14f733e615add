from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vaoi_station.model import BoardType
from vaoi_station.stitching.cad import board_frame
from vaoi_station.stitching.motion import nominal_motion
from vaoi_station.stitching.problem import Adjusted
from vaoi_station.stitching.scene import Scene
from vaoi_station.stitching.uncertainty import MODEL_PX, predicted_sigma

ROWS = 3
BOARD = {
    "name": "b",
    "y_axis": "down",
    "outline": [[0, 0], [16, 30]],
    "components": [{"ref": f"U{y}", "center": [8, y], "width": 1, "height": 1} for y in (2, 15, 28)],
}


def adjusted(shift_sigma_mm: list[float], angle_sigma: float = 0.0, c_sigma_mm: float = 0.0) -> Adjusted:
    """A solution of which only the covariance matters: rows independent, as said."""
    variances = [v for s in shift_sigma_mm for v in (angle_sigma**2, s**2, s**2)]
    covariance = np.diag([*variances, 0.0, 0.0, c_sigma_mm**2, c_sigma_mm**2])
    motion = nominal_motion(np.arange(ROWS, dtype=np.float64), np.array([0.0, 8.0]), np.zeros(2))
    nothing, pairs = np.zeros(0), np.zeros((0, 2))
    c = np.array([1.0, 0.0, -8.0, -24.0])
    return Adjusted(motion, c, nothing, nothing, covariance, nothing, pairs, nothing, pairs, 0.02, 1.0)


@pytest.fixture
def scene(workshop: Any) -> Scene:
    camera = workshop.camera()
    return Scene((camera,), tuple((0, j) for j in range(ROWS)), lambda key: pytest.fail("no pixels are needed"))


@pytest.fixture
def frame(scene: Scene) -> Any:
    return board_frame(BoardType.model_validate(BOARD), scene.cameras[0])


def test_a_shift_of_so_many_mm_is_one_of_so_many_px(scene: Scene, frame: Any) -> None:
    sigma = predicted_sigma(scene, frame, adjusted([0.0, 0.01, 0.03]))
    assert sigma.rows_px == pytest.approx([MODEL_PX, np.hypot(0.1, MODEL_PX), np.hypot(0.3, MODEL_PX)])
    assert sigma.worst_px == pytest.approx(np.hypot(0.3, MODEL_PX))


def test_c_counts_in_every_row(scene: Scene, frame: Any) -> None:
    sigma = predicted_sigma(scene, frame, adjusted([0.0] * 3, c_sigma_mm=0.02))
    assert sigma.rows_px == pytest.approx([np.hypot(0.2, MODEL_PX)] * 3)


def test_an_angle_counts_by_its_arm(scene: Scene, frame: Any) -> None:
    """U28 is seen 4 mm from the pivot in row 0: an angle moves it across; the sigma is that across."""
    sigma = predicted_sigma(scene, frame, adjusted([0.0] * 3, angle_sigma=0.01))
    assert sigma.rows_px[0] == pytest.approx(np.hypot(0.01 * 4 * 10, MODEL_PX), rel=0.01)


def test_without_c_rows_have_a_sigma_and_components_none(scene: Scene, frame: Any) -> None:
    for board, found in (
        (None, adjusted([0.0, 0.01, 0.03])),
        (frame, replace(adjusted([0.0, 0.01, 0.03]), similarity=None)),
    ):
        sigma = predicted_sigma(scene, board, found)
        assert sigma.worst_px is None
        assert sigma.rows_px[2] == pytest.approx(np.hypot(0.3, MODEL_PX))


def test_rows_that_show_no_part_count_by_their_motion_alone(scene: Scene, frame: Any) -> None:
    blind = replace(scene, present=((0, 0), (0, 1)))
    sigma = predicted_sigma(blind, frame, adjusted([0.0, 0.01, 0.5]))
    assert sigma.rows_px[2] == pytest.approx(np.hypot(5.0, MODEL_PX))
    assert sigma.worst_px == pytest.approx(np.hypot(0.1, MODEL_PX))
