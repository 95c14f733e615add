from __future__ import annotations

from typing import Any

import numpy as np

from vaoi_station.calibration.blank_ground import find_blank_ground
from vaoi_station.calibration.mark_detection import MarkAppearance, detect_marks

KIND = MarkAppearance(24.0, 0.25, light=False)


def _expected(rig: Any, frame: Any, *px: tuple[float, float]) -> list[bool]:
    return [bool(v) for v in find_blank_ground(detect_marks(frame, KIND), KIND).at(np.array(px))]


def _free(rig: Any) -> tuple[float, float]:
    """A place of the frame that is far from all marks."""
    marks = np.array([rig.seen_at(0, k) for k in rig.in_view(0)])
    grid = np.stack(np.meshgrid(np.arange(60, 420, 4), np.arange(60, 300, 4)), -1).reshape(-1, 2)
    x, y = grid[np.argmax(np.hypot(*np.moveaxis(grid[:, None] - marks, 2, 0)).min(1))]
    return float(x), float(y)


def test_dirt_and_scratches_hide_the_ground(rig: Any) -> None:
    free = _free(rig)
    x, y = (round(v) for v in free)
    for grey in (25, 110):
        frame = rig.frames[0].copy()
        frame[y - 25 : y + 26, x - 25 : x + 26] = grey
        assert _expected(rig, frame, free) == [False]
    frame = rig.frames[0].copy()
    frame[y - 2 : y + 3, x - 60 : x + 60] = 30
    assert _expected(rig, frame, free) == [False]
