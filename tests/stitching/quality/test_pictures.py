"""Blurred pictures: a reason that names the cameras, on films of the twin whose frames are blurred."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from tests.hostile.drawing import changed, draw
from tests.hostile.filming import film
from tests.hostile.judging import judge, stitched
from tests.hostile.mistakes import Mistake, scenario_changes
from tests.stitching.quality.test_findings import findings_of
from vaoi_station.model import ReasonCode, Status, Stitch
from vaoi_station.stitching.adjustment.problem import REFERENCE
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.quality.pictures import LensError, blur_reasons, camera_blurs, position_errors_px
from vaoi_station.stitching.quality.verdict import judge_result

SEEDS = (3037, 3052, 3071)
"""Drawings of one to three cameras without another mistake."""


def run(seed: int, distortion_px: float) -> tuple[Stitch, Findings]:
    """Stitch a drawing with this distortion, which the calibration leaves out."""
    drawing = draw(seed)
    assert not drawing.mistakes
    mistake = Mistake("lens-ignored", distortion_px)
    scenario = changed(drawing.scenario, scenario_changes(mistake, drawing.scenario))
    mistakes = (mistake,) if distortion_px else ()
    return stitched(film(replace(drawing, scenario=scenario, mistakes=mistakes)))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_calibrated_lens_has_no_error(seed: int) -> None:
    stitch, findings = run(seed, 0.0)
    assert stitch.status is Status.OK
    assert findings.lens_errors
    for error in findings.lens_errors.values():
        assert abs(error.corner_px) < 3 * error.sigma_px
        assert error.sigma_px < 0.15


@pytest.mark.parametrize("seed", SEEDS)
def test_a_distortion_that_the_calibration_leaves_out_is_named(seed: int) -> None:
    stitch, findings = run(seed, 1.5)
    assert stitch.status is Status.DEGRADED
    assert ReasonCode.LENS_DIFFERS in {reason.code for reason in judge_result(findings)[1]}
    for error in findings.lens_errors.values():
        assert error.significant
        assert error.corner_px == pytest.approx(1.5, rel=0.5)


def test_a_small_distortion_widens_sigma() -> None:
    """Positions are wrong by some hundredths of a pixel: σ says so, and the verdict stays."""
    (_, plain), (stitch, bent) = run(3052, 0.0), run(3052, 0.3)
    assert stitch.status is Status.OK
    plain_px, bent_px = (np.sqrt(np.trace(f.sigma.covariance_px2, axis1=1, axis2=2)).mean() for f in (plain, bent))
    assert bent_px > 1.5 * plain_px


def test_noise_is_no_error() -> None:
    assert not LensError(0.3, 0.1).significant
    assert LensError(-1.0, 0.1).significant
    assert not any(position_errors_px({0: LensError(0.05, 0.05), 1: LensError(0.09, 0.05)}, 2).values())
    assert position_errors_px({0: LensError(-1.0, 0.1)}, 1)[0] == pytest.approx(0.2, rel=0.03)
    assert not position_errors_px({}, 3)


def test_a_lens_that_is_badly_seen_has_the_error_that_the_other_cameras_show() -> None:
    """Seed 93217: a distortion of 0.2 px, two cameras of three show it to ± 0.07 px."""
    errors = position_errors_px({0: LensError(0.2, 0.07), 1: LensError(0.25, 0.03), 2: LensError(0.1, 0.08)}, 4)
    assert errors[1] == pytest.approx(0.05, rel=0.05)
    assert 0.02 < errors[2] < errors[0] < errors[1]
    assert errors[3] == pytest.approx(0.05, rel=0.1)


def test_a_lens_that_is_seen_well_keeps_its_own_error() -> None:
    errors = position_errors_px({0: LensError(1.0, 0.1), 1: LensError(0.0, 0.02)}, 2)
    assert errors == {0: pytest.approx(0.2, rel=0.05)}


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
