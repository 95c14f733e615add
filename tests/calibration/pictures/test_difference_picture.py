"""The picture of a difference: complete arrows, and one scale for all cameras."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.calibration.calibration_difference import CalibrationDifference, compare_calibrations
from vaoi_station.calibration.pictures.difference_picture import (
    BAND,
    MARGIN,
    WIDTH,
    draw_difference,
)

_WHITE, _INK = (255, 255, 255), (30, 30, 30)


@pytest.fixture
def knocked(rig: Any) -> CalibrationDifference:
    """Camera 1 is displaced by 2 px to the right; no motion is removed."""
    one = rig.calibrate().calibration()
    n0, n1 = one.camera_matrices
    moved = np.array([[1, 0, -2.0], [0, 1, 0], [0, 0, 1]]) @ n1
    return compare_calibrations(one, one.model_copy(update={"camera_matrices": (n0, moved)}), rig.heads, one_board=True)


def test_colours_mean_the_same_in_every_camera_and_on_the_bar(knocked: CalibrationDifference, rig: Any) -> None:
    picture = draw_difference(knocked, rig.heads)
    at = BAND + MARGIN + round(rig.heads[0].height * WIDTH / rig.heads[0].width / 13)  # between two lines of arrows
    calm, loud = (picture[at, k * (WIDTH + 2 * MARGIN + 8) + MARGIN + WIDTH // 2 + 13] for k in (0, 1))
    foot = picture[-86 + 16]
    assert np.array_equal(foot[MARGIN], calm), "0"
    upper = foot[MARGIN + WIDTH // 4 : MARGIN + WIDTH // 2]
    assert (np.abs(upper.astype(int) - loud).max(1) <= 3).any(), "the bar ends at a round number of at most twice 2 px"
