"""What a camera sees beside the board: texture that moves as it should, a carrier with marks, an unchanged board."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import apply
from vaoi_station.simulation import Twin

Make = Callable[..., Twin]
BOARD = {"width_mm": 8.0, "length_mm": 8.0, "fiducials": []}


def frames(twin: Twin) -> tuple[Any, list[NDArray[np.float64]]]:
    passage = twin.passage(0)
    return passage, [passage.frame(0, row).astype(np.float64) for row in range(passage.rows)]


def beside(passage: Any, row: int, margin_mm: float = 1.0) -> NDArray[np.bool_]:
    """Which pixels (h, w) of a row show what is more than a margin beside the board."""
    camera = passage.pinholes[0]
    y, x = np.mgrid[: camera.height_px, : camera.width_px]
    ground = camera.ground(np.stack([x.ravel(), y.ravel()], -1).astype(np.float64), 0.0)
    place = apply(np.linalg.inv(passage.pose(passage.pulse_times_s[row])), ground)
    return np.asarray((np.abs(place - 4.0) > 4.0 + margin_mm).any(1).reshape(x.shape))


def correlation(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def test_texture_stands_still_or_moves_with_the_board(make: Make) -> None:
    texture = {"sigma_grey": 15.0, "grain_mm": 0.3}
    belt, line = {"grey": 120.0}, {"period_s": 0.03}
    for follows in (0.0, 1.0):
        passage, seen = frames(make(board=BOARD, belt=belt, line=line, texture=texture | {"follows": follows}))
        free = beside(passage, 1) & beside(passage, 2)
        same = correlation(seen[1][free], seen[2][free])
        assert same > 0.9 if follows == 0 else abs(same) < 0.3
    times = passage.pulse_times_s
    step = (passage.pose(times[2]) - passage.pose(times[1]))[1, 2] * passage.twin.scenario.array.px_per_mm
    shift = round(float(step))
    # image y runs along tester y or against it
    moved = [np.roll(seen[1], way * shift, axis=0) for way in (1, -1)]
    inner = np.s_[abs(shift) + 4 : -abs(shift) - 4, 4:16]
    assert max(correlation(one[inner], seen[2][inner]) for one in moved) > 0.7


def test_a_carrier_surrounds_the_board_and_has_its_marks(make: Make) -> None:
    mark = {"x_mm": -1.5, "y_mm": 4.0, "diameter_mm": 1.0}
    carrier = {"rim_mm": 2.5, "grey": 120.0, "sigma_grey": 0.0, "marks": [mark]}
    passage, seen = frames(make(board=BOARD, carrier=carrier))
    row = passage.rows // 2
    pose, camera = passage.pose(passage.pulse_times_s[row]), passage.pinholes[0]

    def grey(*place: float) -> float:
        x, y = camera.project(apply(pose, np.array([place])), 0.0)[0].round().astype(int)
        return float(seen[row][y, x])

    assert grey(-1.5, 4.0) > 180
    assert grey(-1.5, 1.5) == pytest.approx(120, abs=3)
    assert grey(-4.0, 4.0) == pytest.approx(passage.twin.scenario.belt.grey, abs=2)
