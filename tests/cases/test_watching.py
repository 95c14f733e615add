"""Recorded boards with the calibration from before a displacement: the camera is identified, its N_i estimated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.drift.check_run import check_recording
from vaoi_station.drift.checks import RunCheck, combine_runs
from vaoi_station.geometry import Camera
from vaoi_station.geometry.displacement import displace_camera
from vaoi_station.stitching.recordings.opening import open_run

pytestmark = pytest.mark.cases
MOVED = 1
FOCAL_PX, CORNER_PX = 483 * 40.0, 868.8
TENTH_DEG = np.radians(0.1)


def under_old_calibration(case: Path, moved_px: Any) -> tuple[RunCheck, Camera, Camera]:
    """Return the check of a run, the middle camera at its actual pose, and at its calibrated pose."""
    opened = open_run(case)
    cameras = list(opened.setup.cameras)
    actual = cameras[MOVED]
    cameras[MOVED] = displace_camera(actual, -np.array(moved_px))
    setup = replace(opened.setup, cameras=tuple(cameras))
    return check_recording(replace(opened, setup=setup)), actual, cameras[MOVED]


@pytest.mark.parametrize(
    "moved_px", [(0.0, FOCAL_PX * TENTH_DEG, 0.0), (0.0, -FOCAL_PX * TENTH_DEG, 0.0), (0.0, 0.0, CORNER_PX * TENTH_DEG)]
)
def test_displacement_along_the_belt_or_about_the_axis_is_corrected(
    cases: Any, moved_px: tuple[float, float, float]
) -> None:
    checks = [under_old_calibration(cases(name), moved_px) for name in ("ulx3s-top", "ulx3s-top-again")]
    found = combine_runs([check for check, _, _ in checks])
    assert (found.moved, found.rivals) == ((MOVED,), ())
    _, actual, calibrated = checks[0]
    corrected = displace_camera(calibrated, found.displacement_px[MOVED])
    grid = np.stack(np.meshgrid(np.linspace(0, 1391, 9), np.linspace(0, 1039, 7)), -1).reshape(-1, 2)
    off = np.hypot(*(corrected.project(actual.ground(grid)) - grid).T)
    assert np.sqrt((off**2).mean()) < 0.03


@pytest.mark.parametrize("direction", [1, -1])
def test_displacement_with_one_remaining_seam_is_within_its_sigma(cases: Any, direction: int) -> None:
    """The other overlap is too narrow; a single seam hardly separates a moved camera from a higher board.

    Nor does it show which of its two cameras moved. The check names one of the explanations that fit equally well; the
    spread of these explanations reaches the true displacements.
    """
    true_px = np.zeros((3, 3))
    true_px[MOVED, 0] = direction * FOCAL_PX * TENTH_DEG
    check, _, _ = under_old_calibration(cases("ulx3s-top"), true_px[MOVED])
    found = combine_runs([check])
    assert len(found.moved) == 1
    assert MOVED in (*found.moved, *found.rivals)
    assert found.sigma_px[found.moved[0], 0] > 0.25
    information, vector = check.normal_equations()
    costs = [float(d @ information @ d / 2 - d @ vector) for d in (true_px.ravel(), found.displacement_px.ravel())]
    assert abs(costs[0] - costs[1]) < 10
    assert found.spread is not None
    limit_px = 3 * np.sqrt(found.sigma_px**2 + np.diag(found.spread).reshape(3, 3)) + 0.02
    assert (np.abs(found.displacement_px - true_px) < limit_px).all()


@pytest.mark.parametrize("name", ["ulx3s-top", "sparse", "hdr", "repetitive", "warped", "rough"])
def test_unmoved_cameras_show_no_displacement(cases: Any, name: str) -> None:
    check = check_recording(open_run(cases(name)))
    assert max(np.abs(c.displacement_px).max() for c in check.cameras) < 0.03
