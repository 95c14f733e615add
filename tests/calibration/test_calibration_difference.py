from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from vaoi_station.calibration.calibration_difference import GRID, compare_calibrations
from vaoi_station.errors import InputError
from vaoi_station.model import Calibration, Distortion


def test_the_same_board_laid_elsewhere_makes_no_difference(rig: Any) -> None:
    one = rig.calibrate().calibration()
    t = 0.02
    moved = np.array([[math.cos(t), -math.sin(t), 3.0], [math.sin(t), math.cos(t), -2.0], [0, 0, 1]])
    other = one.model_copy(update={"camera_matrices": tuple(n @ moved for n in one.camera_matrices)})
    difference = compare_calibrations(one, other, rig.heads)
    assert max(difference.max_px) < 1e-6
    assert difference.angle_rad == pytest.approx(0.02)
    assert difference.grid_px[0].shape == (GRID[1], GRID[0], 2)


def test_a_knocked_camera_and_a_forgotten_lens_show(rig: Any) -> None:
    one = rig.calibrate().calibration()
    n0, n1 = one.camera_matrices
    knocked = np.array([[1, 0, 2.0], [0, 1, 0], [0, 0, 1]]) @ n1
    other = Calibration.model_validate(one.model_dump() | {"camera_matrices": (n0, knocked)})
    difference = compare_calibrations(one, other, rig.heads)
    assert sum(difference.rms_px) == pytest.approx(2.0, rel=0.1)  # shared out between the two by the common motion
    bent = [Distortion(center=(239.5, 179.5), radius=300.0, radial=(a,)) for a in (0.0, 0.01)]
    other = one.model_copy(update={"distortion": tuple(bent)})
    difference = compare_calibrations(one, other, rig.heads)
    assert difference.max_px[1] > 1.5
    assert f"camera 1: calibrations differ by {difference.rms_px[1]:.3f} px rms" in difference.lines()[2]


def test_calibrations_of_other_arrays_are_refused(rig: Any) -> None:
    one = rig.calibrate().calibration()
    half = Calibration(format="vaoi-calibration", version=1, unit="mm", camera_matrices=one.camera_matrices[:1])
    with pytest.raises(InputError, match="calibrations of 2 and 1 cameras"):
        compare_calibrations(one, half, rig.heads)
