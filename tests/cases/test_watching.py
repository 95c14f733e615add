"""Recorded boards under a calibration from before a knock: the camera is named, and its N_i found again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.drift.checks import RunCheck, combine_runs
from vaoi_station.drift.displacement import displace_camera
from vaoi_station.drift.recorded import check_recording
from vaoi_station.geometry import Camera
from vaoi_station.stitching.recordings.opening import open_run

pytestmark = pytest.mark.cases
KNOCKED = 1
FOCAL_PX, CORNER_PX = 483 * 40.0, 868.8
TENTH_DEG = np.radians(0.1)


def under_old_calibration(case: Path, moved_px: Any) -> tuple[RunCheck, Camera, Camera]:
    """Return the check of a run, the middle camera as it is, and as it was calibrated before it moved."""
    opened = open_run(case)
    cameras = list(opened.setup.cameras)
    hangs = cameras[KNOCKED]
    cameras[KNOCKED] = displace_camera(hangs, -np.array(moved_px))
    setup = replace(opened.setup, cameras=tuple(cameras))
    return check_recording(replace(opened, setup=setup)), hangs, cameras[KNOCKED]


@pytest.mark.parametrize(
    "moved_px", [(0.0, FOCAL_PX * TENTH_DEG, 0.0), (0.0, -FOCAL_PX * TENTH_DEG, 0.0), (0.0, 0.0, CORNER_PX * TENTH_DEG)]
)
def test_a_knock_along_the_belt_or_about_the_axis_is_undone(cases: Any, moved_px: tuple[float, float, float]) -> None:
    checks = [under_old_calibration(cases(name), moved_px) for name in ("ulx3s-top", "ulx3s-top-again")]
    found = combine_runs([check for check, _, _ in checks])
    assert (found.moved, found.rivals) == ((KNOCKED,), ())
    _, hangs, calibrated = checks[0]
    corrected = displace_camera(calibrated, found.displacement_px[KNOCKED])
    grid = np.stack(np.meshgrid(np.linspace(0, 1391, 9), np.linspace(0, 1039, 7)), -1).reshape(-1, 2)
    off = np.hypot(*(corrected.project(hangs.ground(grid)) - grid).T)
    assert np.sqrt((off**2).mean()) < 0.03


@pytest.mark.parametrize("way", [1, -1])
def test_a_knock_that_leaves_one_neighbour_stays_within_its_sigma(cases: Any, way: int) -> None:
    """The other overlap is too narrow then, and one alone does not separate a moved camera from a higher board."""
    moved_px = (way * FOCAL_PX * TENTH_DEG, 0.0, 0.0)
    check, _, _ = under_old_calibration(cases("ulx3s-top"), moved_px)
    found = combine_runs([check])
    assert found.moved == (KNOCKED,)
    off = found.displacement_px[KNOCKED] - moved_px
    assert found.sigma_px[KNOCKED, 0] > 0.25
    assert (np.abs(off) < 3 * found.sigma_px[KNOCKED] + 0.02).all()


@pytest.mark.parametrize("name", ["ulx3s-top", "sparse", "hdr", "repetitive", "warped", "rough"])
def test_unmoved_cameras_show_no_displacement(cases: Any, name: str) -> None:
    check = check_recording(open_run(cases(name)))
    assert max(np.abs(c.displacement_px).max() for c in check.cameras) < 0.03
