"""Marks at the places of fiducials."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vaoi_station.board_check.fiducials import distances_of_marks
from vaoi_station.board_check.run_frames import CheckedRun
from vaoi_station.model import BoardType


def test_a_mark_is_measured_where_it_is_and_missed_where_it_is_not(run: CheckedRun, board: BoardType) -> None:
    first, *rest = board.fiducials
    near = first.model_copy(update={"name": "near", "x": first.x + 0.1})
    bare = first.model_copy(update={"name": "bare", "x": 25.0, "y": 1.5})
    far = first.model_copy(update={"name": "far", "x": 80.0})
    changed = board.model_copy(update={"outline": None, "fiducials": (near, bare, far, *rest)})
    found = distances_of_marks(run, changed, np.array(run.stitch.cad_matrix))
    assert abs(found[0] - 0.1) < 0.01
    assert math.isnan(found[1])
    assert math.isnan(found[2])
    assert max(found[3:]) < 0.01


def test_a_mark_without_contrast_under_one_light_is_searched_under_another(run: CheckedRun, board: BoardType) -> None:
    stitch = run.stitch
    twice = {"row_motion": stitch.row_motion * 2, "image_matrices": tuple(m * 2 for m in stitch.image_matrices)}

    def frame(camera: int, row: int) -> NDArray[np.generic] | None:
        pixels = run.frame(camera, 0)
        return np.full_like(pixels, 20) if pixels is not None and row == 0 else pixels

    changed = replace(run, stitch=stitch.model_copy(update=twice), frame=frame)
    matrix = np.array(stitch.cad_matrix)
    assert all(math.isnan(distance) for distance in distances_of_marks(changed, board, matrix))
    two_lights = replace(changed, lights=("dark", "bright"))
    assert max(distances_of_marks(two_lights, board, matrix)) < 0.01
