"""Marks at the places of fiducials."""

from __future__ import annotations

import math

import numpy as np

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
