"""The picture of all that was filmed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vaoi_station.board_check.overview import make_overview
from vaoi_station.board_check.run_frames import CheckedRun
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


def test_edges_are_strong_across_themselves(run: CheckedRun) -> None:
    overview = replace(run.overview, grey=np.repeat([[20] * 60 + [200] * 60], 100, 0).astype(np.uint8))
    overview = replace(overview, seen=np.ones(overview.grey.shape, np.bool_))
    vertical, horizontal = overview.edges(0.2)
    assert vertical[50].argmax() in (59, 60)
    assert vertical.max() > 1.0 > 10 * np.abs(horizontal).max()


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
