from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.calibration.artwork import Board
from vaoi_station.calibration.artwork.drawing_elements import (
    BAR_MM,
    LABEL_MM,
    arrow,
    label_baseline_mm,
    scale_bar,
)


@pytest.mark.parametrize(("width", "length"), [(100.0, BAR_MM), (60.0, BAR_MM), (59.0, 10.0), (25.0, 10.0)])
def test_the_scale_bar_is_shorter_on_small_boards_and_lies_in_the_label_strip(width: float, length: float) -> None:
    low, high = (-5.0, -20.0), (width - 5.0, 30.0)
    strokes, reported = scale_bar(low, high)
    assert reported == length
    assert np.hypot(*(strokes[0, 1] - strokes[0, 0])) == pytest.approx(length)
    assert strokes[..., 0].min() >= low[0]
    assert strokes[..., 0].max() <= high[0]
    assert strokes[..., 1].min() >= high[1] - LABEL_MM
    assert strokes[..., 1].max() <= high[1]


def test_the_arrow_points_along_the_cameras_below_the_views(board: Board) -> None:
    shaft, *head = arrow(board.low_mm, board.high_mm, 0.0)
    assert shaft[1, 0] - shaft[0, 0] >= 3.0
    assert shaft[:, 1] == pytest.approx(label_baseline_mm(board.high_mm) - 0.9)
    assert all(stroke[1] == pytest.approx(shaft[1]) for stroke in head)
    assert min(shaft[:, 1]) > 13.0
