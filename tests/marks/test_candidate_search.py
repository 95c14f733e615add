from __future__ import annotations

from collections.abc import Callable
from typing import Any, get_args

import numpy as np
import pytest

from vaoi_station.marks import Mark, find_candidates, locate_mark
from vaoi_station.marks.mark_shape import Shape

SHAPES = get_args(Shape)
Paint = Callable[..., Any]
PLACES = [(20.3, 25.6), (70.8, 22.1), (45.0, 50.5), (102.4, 61.2)]


@pytest.mark.parametrize("light", [True, False])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("size", [6.0, 9.0])
def test_every_mark_is_found(paint: Paint, shape: Shape, light: bool, size: float) -> None:
    grey = {"mark": 210.0, "ground": 60.0} if light else {"mark": 30.0, "ground": 170.0}
    image = paint([(shape, x, y, size) for x, y in PLACES], size=(128, 88), noise=2.0, **grey)
    places, scores = find_candidates(image, shape, size)
    for truth in PLACES:
        distance = np.hypot(*(places - truth).T)
        assert distance.min() < 0.9
        assert scores[distance.argmin()] > 0.8
        assert isinstance(locate_mark(image, places[distance.argmin()], shape, size), Mark)
    assert (np.diff(scores) <= 0).all(), "the best first"


@pytest.mark.parametrize("shape", SHAPES)
def test_a_mark_without_a_bare_rim_is_no_candidate(paint: Paint, shape: Shape) -> None:
    image = paint([(shape, 45.0, 40.0, 9.0)], size=(96, 80))
    image[:, 51:] = 210
    image[:, :40] = 210
    places, _ = find_candidates(image, shape, 9.0)
    assert not len(places) or np.hypot(*(places - (45.0, 40.0)).T).min() > 2


def test_all_marks_of_a_regular_pattern_are_returned() -> None:
    """There are more hits than the first buffer of the search holds."""
    y, x = np.mgrid[:240, :300]
    image = np.where((x % 12 < 6) & (y % 12 < 6), 200, 60).astype(np.uint8)
    assert len(find_candidates(image, "square", 6.0, most=1000)[0]) > 256
