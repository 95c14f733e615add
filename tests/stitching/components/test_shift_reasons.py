"""A board whose components contradict its fiducials has a reason that names them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.stitching.quality.test_agreement import PLANE, adjusted, points
from vaoi_station.model import ReasonCode
from vaoi_station.stitching.components.centres import ComponentShift, component_reasons

SMALL = np.diag([0.003, 0.003, 0.003, 0.003]) ** 2
SOUND = ComponentShift(np.array([0.01, -0.01, 0.0, 0.004]), SMALL, np.zeros(2), 12.0, 20)


def test_components_that_lie_elsewhere_than_the_fiducials_put_them_are_a_reason() -> None:
    assert component_reasons(None, PLANE, adjusted(2), points(2), 10.0) == []
    assert component_reasons(SOUND, PLANE, adjusted(2), points(2), 10.0) == []
    wrong = replace(SOUND, measured=np.array([0.06, -0.02, 0.0, 0.03]))
    ((code, text),) = component_reasons(wrong, PLANE, adjusted(2), points(2), 10.0)
    assert code is ReasonCode.COMPONENTS_SHIFTED
    assert "20 components are centred (+0.060, -0.020) mm ± (0.012, 0.012)" in text
    assert "px) at fiducial F" in text


def test_of_two_fiducials_the_one_whose_error_explains_the_components_is_named() -> None:
    """F1, 36 mm from F0, is off by 0.07 mm across their line: no check but this one sees it."""
    turned = replace(SOUND, measured=np.array([-0.001, 0.035, 0.024, 0.0]))
    assert not turned.contradicts
    ((code, text),) = component_reasons(turned, PLANE, adjusted(2), points(2), 10.0)
    assert code is ReasonCode.COMPONENTS_SHIFTED
    assert "as if one of the two fiducials were not at its CAD position: F1 by 0.07 mm (0.7 px)" in text
    assert component_reasons(turned, PLANE, adjusted(3), points(3), 10.0) == [], "a third fiducial is redundant"
    assert component_reasons(turned, PLANE, adjusted(2), points(2), 4.0) == [], "0.28 px, which other checks accept"
