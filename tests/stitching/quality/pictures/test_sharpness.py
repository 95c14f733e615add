"""Blurred pictures: a reason that names the cameras, on films of the twin whose frames are blurred."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from tests.hostile.judging import judge
from tests.stitching.quality.test_findings import findings_of
from vaoi_station.model import ReasonCode, Status
from vaoi_station.stitching.adjustment.problem import REFERENCE
from vaoi_station.stitching.quality.pictures import blur_reasons, camera_blurs


def blurs_of(found: Any, scene: Any = None, points: Any = None) -> dict[int, float]:
    return camera_blurs(found.plane, scene or found.scene, points or found.mapping.problem.fiducials)


def blurred(filmed: Any, sigma_px: float, cameras: set[int]) -> dict[tuple[int, int], Any]:
    return {
        key: cv2.GaussianBlur(frame, (0, 0), sigma_px) if sigma_px and key[0] in cameras else frame
        for key, frame in filmed.frames.items()
    }


def test_sharp_pictures_have_no_reason(filmed: Any) -> None:
    blurs = blurs_of(findings_of(filmed))
    assert set(blurs) == {0, 1}
    assert max(blurs.values()) < 1.5
    assert blur_reasons(blurs) == []


@pytest.mark.parametrize("cameras", [{0}, {0, 1}])
def test_the_cameras_whose_pictures_are_blurred_are_named(filmed: Any, cameras: set[int]) -> None:
    result = filmed.stitched(frames=blurred(filmed, 2.4, cameras))
    assert result.status is Status.DEGRADED
    assert ReasonCode.PICTURES_BLURRED in result.reason_codes
    (text,) = (r for r in result.reasons if r.startswith("pictures are blurred"))
    assert {camera for camera in (0, 1) if f"camera {camera} by 2." in text} == cameras


def test_the_sharpest_fiducial_of_a_camera_counts(filmed: Any) -> None:
    """One that is covered by flux, or has a soft edge, says nothing about the lens."""
    found: Any = findings_of(filmed)
    points = found.mapping.problem.fiducials
    camera = int(np.bincount(points.camera).argmax())
    first, *others = np.flatnonzero(points.camera == camera).tolist()
    assert others
    at = (camera, int(points.row[first]))
    soft = filmed.frames | {at: cv2.GaussianBlur(filmed.frames[at], (0, 0), 3.0)}
    assert blurs_of(found, findings_of(filmed, soft).scene)[camera] < 1.5
    only = blurs_of(found, findings_of(filmed, soft).scene, points.select(np.array([first])))
    assert only[camera] > 2.5


def test_points_of_a_reference_are_not_measured(filmed: Any) -> None:
    found: Any = findings_of(filmed)
    points = found.mapping.problem.fiducials
    referred = replace(points, which=np.full(len(points.which), REFERENCE))
    assert blurs_of(found, points=referred) == {}


@pytest.mark.parametrize("seed", [109942, 111791, 112019])
def test_blurred_drawings_that_were_wrong_are_named(seed: int) -> None:
    """Corners near the board's edge placed a last row by up to 1.5 px beyond its σ."""
    outcome = judge(seed)
    assert (outcome.status, outcome.finds) == ("degraded", ())
    assert any(reason.startswith("pictures are blurred") for reason in outcome.reasons)
