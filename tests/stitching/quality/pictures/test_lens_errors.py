"""The radial error of a camera's picture is estimated from the links, and a calibration that leaves it out is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.hostile.drawing import changed, draw
from tests.hostile.filming import film
from tests.hostile.judging import stitched
from tests.hostile.mistakes import Mistake, scenario_changes
from vaoi_station.model import ReasonCode, Status, Stitch
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.quality.pictures import LensError, position_errors_px
from vaoi_station.stitching.quality.verdict import decide_verdict

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
    assert ReasonCode.LENS_DIFFERS in {code for code, _ in decide_verdict(findings)[1]}
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
