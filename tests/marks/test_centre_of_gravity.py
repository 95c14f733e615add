from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.geometry.robust import Failure
from vaoi_station.marks.centre_of_gravity import locate_by_centre_of_gravity
from vaoi_station.marks.mark_shape import Shape, coverage


@pytest.mark.parametrize("shape", ["circle", "cross", "square", "diamond"])
@pytest.mark.parametrize("light", [False, True])
def test_the_paper_method_locates_a_mark_to_half_a_pixel(shape: Shape, light: bool) -> None:
    ink, paper = (210, 40) if light else (40, 210)
    image = np.rint(paper + (ink - paper) * coverage(shape, 24.0, 160, (83.3, 71.6))).astype(np.uint8)
    found = locate_by_centre_of_gravity(image, np.array([80.0, 76.0]), shape, 24.0, light=light)
    assert not isinstance(found, Failure)
    assert np.hypot(*(found - (83.3, 71.6))) < 0.5


def test_a_missing_mark_is_a_failure() -> None:
    image = np.random.default_rng(1).integers(90, 110, (160, 160)).astype(np.uint8)
    found = locate_by_centre_of_gravity(image, np.array([80.0, 80.0]), "cross", 24.0, light=True)
    assert isinstance(found, Failure)
    assert "correlation" in found.reason
    cut = locate_by_centre_of_gravity(image[:20], np.array([5.0, 5.0]), "cross", 24.0, light=True)
    assert isinstance(cut, Failure)
    assert "border" in cut.reason
