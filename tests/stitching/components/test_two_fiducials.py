"""An error of one of two fiducials is found by what it does to the components, on shifts that are made up exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.stitching.quality.test_agreement import PLANE, points
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.problem import REFERENCE
from vaoi_station.stitching.components.centres import ComponentShift, likely_errors, two_that_place, unnoticed_mm

FIDUCIALS = np.array([[-12.0, -7.0], [13.0, 6.0]])
NONE = ComponentShift(np.zeros(4), np.diag([0.006, 0.005, 0.005, 0.006]) ** 2, np.array([4.0, -1.0]), 9.0, 20)


def shown(which: int, error_mm: Floats) -> ComponentShift:
    """Return what components show if this fiducial is off by an error, and the other is right."""
    wrong, right = FIDUCIALS[which], FIDUCIALS[1 - which]
    places = np.random.default_rng(2).normal(0, 9, (40, 2))
    # the similarity that leaves `right` in place and moves `wrong` by the error
    slope = complex(*error_mm) / complex(*(wrong - right))
    moved = slope * ((places - right) @ (1, 1j))
    each = [replace(NONE, measured=unit).at(places).ravel() for unit in np.eye(4)]
    unknowns = np.linalg.lstsq(np.array(each).T, np.column_stack([moved.real, moved.imag]).ravel(), rcond=None)[0]
    return replace(NONE, measured=unknowns)


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("angle", [0.0, 1.1, 2.0, 3.0])
def test_an_error_that_is_no_contradiction_by_itself_is_found(which: int, angle: float) -> None:
    shift = shown(which, 0.07 * np.array([np.cos(angle), np.sin(angle)]))
    assert not shift.contradicts
    first, *others = likely_errors(shift, FIDUCIALS)
    assert first.which == which
    assert first.mm == pytest.approx(0.07, rel=1e-3)
    assert all(other.chi2 < first.chi2 for other in others)


def test_without_an_error_none_is_found() -> None:
    assert likely_errors(NONE, FIDUCIALS) == []
    assert likely_errors(shown(0, np.array([0.02, 0.01])), FIDUCIALS) == []


def test_what_no_error_of_one_fiducial_explains_is_none() -> None:
    """A light from one side shifts all components alike: that would need the same error of both fiducials."""
    assert likely_errors(replace(NONE, measured=np.array([0.035, 0.02, 0.0, 0.0])), FIDUCIALS) == []


def test_a_smaller_error_of_one_of_two_fiducials_may_go_unnoticed() -> None:
    """Errors of the stated size, in every direction, are two standard deviations beyond the limit, or further."""
    limit, beyond = unnoticed_mm(NONE, FIDUCIALS), []
    for angle in np.linspace(0, np.pi, 60):
        error = limit * np.array([np.cos(angle), np.sin(angle)])
        beyond += [likely_errors(shown(which, error), FIDUCIALS)[0].chi2 for which in (0, 1)]
    assert min(beyond) == pytest.approx((np.sqrt(10) + 2) ** 2, rel=1e-2)
    assert unnoticed_mm(NONE, 5 * FIDUCIALS) > limit, "fiducials further out are shown less well by the same components"


def test_only_two_fiducials_that_alone_determine_c_are_returned() -> None:
    two = two_that_place(PLANE, points(2))
    assert two is not None
    assert two.tolist() == [0, 1]
    assert two_that_place(PLANE, None) is two_that_place(PLANE, points(3)) is two_that_place(PLANE, points(1)) is None
    referred = replace(points(3), which=np.array([0, 1, REFERENCE]))
    assert two_that_place(PLANE, referred) is None
