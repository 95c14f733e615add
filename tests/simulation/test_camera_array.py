"""Cameras of one array may differ; by default all of them are alike."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.simulation.imaging.pinholes import mount_cameras
from vaoi_station.simulation.imaging.sensor import vignette
from vaoi_station.simulation.scenario import ArraySection

EXACT = ArraySection(tilt_deg=0, roll_deg=0, position_mm=0, focal_length=0)


def test_lists_are_repeated() -> None:
    array = EXACT.model_copy(update={"camera_px_per_mm": (40.0, 28.0), "camera_roll_deg": (0.0, 180.0)})
    assert [array.resolution_px_per_mm(i) for i in range(3)] == [40, 28, 40]
    assert [array.design_roll_deg(i) for i in range(3)] == [0, 180, 0]
    assert array.finest_px_per_mm == 40


@pytest.mark.parametrize(
    "design",
    [
        {"camera_px_per_mm": (40.0, 28.0, 40.0)},
        {"camera_frame_px": ((1392, 1040), (800, 900), (1392, 1040))},
        {"camera_roll_deg": (0.0, 90.0, 270.0)},
        {"camera_roll_deg": (90.0,)},
    ],
)
def test_neighbours_overlap_by_the_same_share_of_their_views(design: dict[str, object]) -> None:
    array = EXACT.model_copy(update=design)
    for i in range(2):
        a, b = array.camera_view_mm(i)[0], array.camera_view_mm(i + 1)[0]
        assert array.center_mm(i + 1) - array.center_mm(i) == pytest.approx((a + b) / 2 / array.overlap)


@pytest.mark.parametrize("roll", [10.0, 90.0, 180.0])
def test_a_camera_is_mounted_as_its_design_says(roll: float) -> None:
    array = EXACT.model_copy(
        update={"camera_roll_deg": (0.0, roll), "camera_px_per_mm": (40.0, 28.0), "camera_frame_px": ((640, 480),)}
    )
    pinhole, middle = mount_cameras(array)[1], np.array([array.center_mm(1), 0.0])
    seen = pinhole.project(np.array([middle, middle + (1.0, 0.0)]), 0.0)
    turn = np.radians(roll)
    assert (pinhole.width_px, pinhole.height_px) == (640, 480)
    assert seen[0] == pytest.approx((319.5, 239.5))
    assert seen[1] - seen[0] == pytest.approx((28 * np.cos(turn), 28 * np.sin(turn)))
    assert vignette(array, 1).shape == (480, 640)
