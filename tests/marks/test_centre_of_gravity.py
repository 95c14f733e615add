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
    image = np.rint(paper + (ink - paper) * coverage(shape, 24.0, 161)).astype(np.uint8)
    found = locate_by_centre_of_gravity(image, np.array([77.0, 84.0]), shape, 24.0, light=light)
    assert not isinstance(found, Failure)
    assert np.hypot(*(found - (80.0, 80.0))) < 0.5
