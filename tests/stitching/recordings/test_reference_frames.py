"""The selection of frames that are kept as a reference."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.model import BoardType, Status, Stitch
from vaoi_station.stitching.recordings.references import MOST_PER_ROW, select_reference_frames

BOARD = BoardType(name="b", outline=((0.0, 0.0), (60.0, 40.0)))
"""Its middle lies at tester (0, 0); cameras show 20 × 16 mm, one beside the other."""


def stitch_of(rows: int, step_mm: float, *, mirrored: bool = True) -> Stitch:
    motion = tuple(np.array([[1, 0, 0], [0, 1, step_mm * j], [0, 0, 1.0]]) for j in range(rows))
    c = (
        np.array([[1, 0, -30], [0, -1, 20], [0, 0, 1.0]])
        if mirrored
        else np.array([[1, 0, -30], [0, 1, -20], [0, 0, 1.0]])
    )
    return Stitch(method="auto", image_matrices=(), cad_matrix=c, row_motion=motion, status=Status.OK)


def row_of_cameras(workshop: Any, n: int, apart_mm: float) -> tuple[Any, ...]:
    return tuple(workshop.camera(((i - (n - 1) / 2) * apart_mm, 0.0)) for i in range(n))


@pytest.mark.parametrize("mirrored", [True, False])
def test_a_few_cameras_are_kept_with_the_outermost_among_them(workshop: Any, mirrored: bool) -> None:
    cameras = row_of_cameras(workshop, 9, 6.0)
    present = {(i, 0) for i in range(9)}
    chosen = select_reference_frames(stitch_of(1, 0.0, mirrored=mirrored), cameras, BOARD, present)
    assert chosen == {(0, 0), (3, 0), (5, 0), (8, 0)}
    assert len(chosen) == MOST_PER_ROW
    assert select_reference_frames(stitch_of(1, 0.0), cameras, BOARD, present - {(0, 0)}) == {
        (1, 0),
        (3, 0),
        (6, 0),
        (8, 0),
    }


def test_frames_that_hardly_show_the_board_are_not_kept(workshop: Any) -> None:
    cameras = row_of_cameras(workshop, 3, 41.0)
    present = {(i, j) for i in range(3) for j in range(4)}
    chosen = select_reference_frames(stitch_of(4, 13.9), cameras, BOARD, present)
    assert chosen == {(1, 0), (1, 1)}, "the board covers only the edge of the third row's frame"
