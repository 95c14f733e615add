"""The picture of all that was filmed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vaoi_station.board_check.overview import CheckedRun, make_overview
from vaoi_station.errors import StateError
from vaoi_station.geometry import apply
from vaoi_station.model import BoardType


def test_places_of_the_picture_are_those_of_the_frames(run: CheckedRun, board: BoardType) -> None:
    overview = run.overview
    assert overview.px_per_mm == 8.0
    assert run.stitch.cad_matrix is not None
    mark = apply(
        overview.px_from_tester @ run.stitch.cad_matrix, np.array([board.fiducials[0].x, board.fiducials[0].y])
    )
    y, x = np.mgrid[-9:10, -9:10]
    at = np.rint(mark).astype(int)
    part = overview.grey[at[1] - 9 : at[1] + 10, at[0] - 9 : at[0] + 10].astype(float)
    weight = np.maximum(part - 80, 0)
    centre = np.array([(x * weight).sum(), (y * weight).sum()]) / weight.sum() + at
    assert np.hypot(*(centre - mark)) < 0.1


def test_rows_of_other_lights_and_missing_frames_are_left_out(run: CheckedRun) -> None:
    asked: list[tuple[int, int]] = []

    def frame(camera: int, row: int) -> None:
        asked.append((camera, row))

    stitch = run.stitch
    three = stitch.model_copy(
        update={"image_matrices": (stitch.image_matrices[0] * 3,), "row_motion": stitch.row_motion * 3}
    )
    overview = make_overview(three, run.cameras, frame, ("left", "right", "left"))
    assert asked == [(0, 0), (0, 2)]
    assert not overview.seen.any()
    nothing = stitch.model_copy(update={"image_matrices": ((None,),)})
    with pytest.raises(StateError, match="no placed frame"):
        make_overview(nothing, run.cameras, frame)


def test_c_of_the_run_holds_for_data_in_other_units_and_axes(run: CheckedRun, board: BoardType) -> None:
    other = board.model_copy(update={"unit": "inch", "y_axis": "down"})
    stated = run.stated_matrix(other)
    assert stated is not None
    assert run.stitch.cad_matrix is not None
    there = apply(run.stitch.cad_matrix, np.array([20.0, 10.0]))
    assert apply(stated, np.array([20.0 / 25.4, -10.0 / 25.4])) == pytest.approx(there)
    assert replace(run, board_type=None).stated_matrix(other) is None
