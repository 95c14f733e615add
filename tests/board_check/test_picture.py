"""The picture for the engineer."""

from __future__ import annotations

import numpy as np

from vaoi_station.board_check.picture import FOUND, STATED, UNLIKELY, overlay
from vaoi_station.board_check.run_frames import CheckedRun
from vaoi_station.model import BoardType


def has(picture: np.ndarray, colour: tuple[int, int, int]) -> bool:
    return bool((np.abs(picture.astype(int) - colour).sum(2) < 60).any())


def test_bodies_are_drawn_where_they_are_stated_and_found(run: CheckedRun, board: BoardType) -> None:
    c = np.array(run.stitch.cad_matrix)
    found = c.copy()
    found[0, 2] += 3.0
    picture = overlay(run.overview, board, found, c, {"U1"})
    assert picture.ndim == 3
    assert 400 <= max(picture.shape) <= 1600
    assert [has(picture, colour) for colour in (FOUND, STATED, UNLIKELY)] == [True] * 3
    assert not has(overlay(run.overview, board, found, None, ()), STATED)
    assert not has(overlay(run.overview, board, None, None, ()), FOUND)
