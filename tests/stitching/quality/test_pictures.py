"""Blurred pictures: a reason that names the cameras, on films of the twin whose frames are blurred."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import pytest

from tests.hostile.drawing import changed, draw
from tests.hostile.filming import film
from tests.hostile.judging import judge, stitched
from tests.hostile.mistakes import Mistake, scenario_changes
from vaoi_station.model import ReasonCode, Status, Stitch
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.quality.verdict import judge_result

SEEDS = (3037, 3071)
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
def test_a_distortion_that_the_calibration_leaves_out_is_named(seed: int) -> None:
    stitch, findings = run(seed, 1.5)
    assert stitch.status is Status.DEGRADED
    assert ReasonCode.LENS_DIFFERS in {reason.code for reason in judge_result(findings)[1]}
    for error in findings.lens_errors.values():
        assert error.significant
        assert error.corner_px == pytest.approx(1.5, rel=0.5)


def blurred(filmed: Any, sigma_px: float, cameras: set[int]) -> dict[tuple[int, int], Any]:
    return {
        key: cv2.GaussianBlur(frame, (0, 0), sigma_px) if sigma_px and key[0] in cameras else frame
        for key, frame in filmed.frames.items()
    }


def test_the_cameras_whose_pictures_are_blurred_are_named(filmed: Any) -> None:
    result = filmed.stitched(frames=blurred(filmed, 3.0, {0}))
    assert result.status is Status.DEGRADED
    assert ReasonCode.PICTURES_BLURRED in result.reason_codes
    (text,) = (r for r in result.reasons if r.startswith("pictures are blurred"))
    assert {camera for camera in (0, 1) if f"camera {camera} by " in text} == {0}


def test_a_blurred_drawing_that_was_wrong_is_named() -> None:
    """Corners near the board's edge placed a last row by up to 1.5 px beyond its σ."""
    outcome = judge(111791)
    assert (outcome.status, outcome.finds) == ("degraded", ())
    assert any(reason.startswith("positions are uncertain") for reason in outcome.reasons)


def test_a_lens_that_is_a_little_soft_is_no_alarm(filmed: Any) -> None:
    result = filmed.stitched(frames=blurred(filmed, 2.1, {0, 1}))
    assert result.status is Status.OK, result.reasons
    assert filmed.error_px(result) < 0.1
