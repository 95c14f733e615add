from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.calibration.array_assignment import DECISIVE, assign_array
from vaoi_station.calibration.artwork import ArrayDesign, design_board
from vaoi_station.calibration.mark_identification import Hypothesis, find_hypotheses
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import CameraHead

W, H, R, PITCH, SIZE = 1392, 1040, 40.0, 33.1, 80.0
HEADS = tuple(
    CameraHead(width=W, height=H, exposure_us=1.0, nominal_center_mm=(i * PITCH, 0.0), nominal_px_per_mm=R)
    for i in range(3)
)
SPACING = 4.0
X, Y = np.arange(-20, 60) * SPACING, np.arange(-20, 20) * SPACING
ENDLESS = np.stack(np.meshgrid(X, Y), -1).reshape(-1, 2)


def _options(marks: Floats, camera: int, shift: tuple[float, float], turn_deg: float) -> tuple[Hypothesis, ...]:
    t = np.radians(turn_deg)
    turn = np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]])
    px = (marks - (camera * PITCH, 0.0) - shift) @ turn.T * R + ((W - 1) / 2, (H - 1) / 2)
    inside = ((px > 60) & (px < (W - 60, H - 60))).all(1)
    return find_hypotheses(px[inside], marks, HEADS[camera], camera, SIZE)


def test_the_common_offset_of_all_cameras_decides_for_a_grid_that_fills_every_view() -> None:
    shifts = [(1.0, 0.3), (1.4, -0.1), (2.15, 0.2)]  # the last is nearer to a wrong one
    options = [_options(ENDLESS, camera, shift, 0.3) for camera, shift in enumerate(shifts)]
    found = tuple(assign_array(options, HEADS, 2.0))
    chosen = [a.chosen.offset_mm for a in found if a.chosen is not None]
    assert np.abs(np.array(chosen) - shifts).max() < 0.02
    assert all(a.rival is not None for a in found)
    assert np.hypot(*found[0].shift_mm) == pytest.approx(SPACING, rel=0.01)


@pytest.mark.parametrize(("tolerance_mm", "ambiguous", "by_nominal_view"), [(3.0, True, False), (1.2, False, True)])
def test_the_stated_tolerance_decides_whether_a_grid_that_fills_the_view_is_known(
    tolerance_mm: float, ambiguous: bool, by_nominal_view: bool
) -> None:
    (found,) = assign_array([_options(ENDLESS, 0, (0.3, -0.2), 0.2)], HEADS[:1], tolerance_mm)
    assert found.chosen is not None
    assert np.abs(found.chosen.offset_mm - (0.3, -0.2)).max() < 0.02
    assert (found.ambiguous, found.by_nominal_view) == (ambiguous, by_nominal_view)


def test_one_camera_that_sees_the_rim_decides_for_its_neighbours() -> None:
    endless = ENDLESS[np.abs(ENDLESS[:, 1]) < 9]
    ending = endless[endless[:, 0] > -9]

    def advantages(marks: Floats) -> list[float]:
        options = [_options(marks, camera, (0.4, 0.1), 0.1) for camera in range(3)]
        return [a.advantage for a in assign_array(options, HEADS, 2.0)]

    alone, decided = advantages(endless), advantages(ending)
    assert decided[0] > DECISIVE + 5
    assert min(decided[1:]) > min(alone[1:]) + 0.5


def test_the_designed_board_is_unambiguous() -> None:
    marks = design_board(ArrayDesign(3, PITCH, (W / R, H / R))).places_mm
    options = [_options(marks, camera, (1.0, -2.0), 2.0) for camera in range(3)]
    assert all(a.seen > DECISIVE and not a.ambiguous for a in assign_array(options, HEADS, 3.0))
