"""A run with its frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vaoi_station.board_check.run_frames import CheckedRun
from vaoi_station.geometry import apply
from vaoi_station.model import BoardType


def test_c_of_the_run_holds_for_data_in_other_units_and_axes(run: CheckedRun, board: BoardType) -> None:
    other = board.model_copy(update={"unit": "inch", "y_axis": "down"})
    stated = run.stated_matrix(other)
    assert stated is not None
    assert run.stitch.cad_matrix is not None
    there = apply(run.stitch.cad_matrix, np.array([20.0, 10.0]))
    assert apply(stated, np.array([20.0 / 25.4, -10.0 / 25.4])) == pytest.approx(there)
    assert replace(run, board_type=None).stated_matrix(other) is None


def test_motion_and_scene_are_those_of_the_result(run: CheckedRun) -> None:
    turned = np.array([[0.0, -1.0, 3.0], [1.0, 0.0, 4.0], [0, 0, 1]])
    stitch = run.stitch.model_copy(
        update={"image_matrices": ((*run.stitch.image_matrices[0], None),), "row_motion": (np.eye(3), turned)}
    )
    two = replace(run, stitch=stitch)
    np.testing.assert_allclose(two.motion.rows_from_tester[1], turned, atol=1e-12)
    assert two.scene.present == ((0, 0),)
    with pytest.raises(LookupError):
        replace(two, frame=lambda _, __: None).scene.prepared((0, 0))
