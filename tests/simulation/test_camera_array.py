"""Cameras of one array may differ; by default all of them are alike."""

from __future__ import annotations

import pytest

from vaoi_station.simulation.scenario import ArraySection

EXACT = ArraySection(tilt_deg=0, roll_deg=0, position_mm=0, focal_length=0)


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
