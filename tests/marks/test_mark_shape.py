from __future__ import annotations

from collections.abc import Callable
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.marks.mark_shape import Shape, coverage

SHAPES = get_args(Shape)
AREA = {"circle": np.pi / 4, "square": 1.0, "diamond": 0.5, "cross": 7 / 16}


@given(shape=st.sampled_from(SHAPES), size=st.floats(8, 30), at=st.tuples(st.floats(-2, 2), st.floats(-2, 2)))
def test_coverage_is_a_share_and_adds_up_to_the_area(shape: Shape, size: float, at: tuple[float, float]) -> None:
    picture = coverage(shape, size, 41, (20 + at[0], 20 + at[1]))
    assert picture.min() >= 0
    assert picture.max() <= 1
    assert picture.sum() == pytest.approx(AREA[shape] * size**2, rel=0.02, abs=4)
    y, x = np.mgrid[:41, :41]
    assert (picture * x).sum() / picture.sum() == pytest.approx(20 + at[0], abs=0.12)
    assert (picture * y).sum() / picture.sum() == pytest.approx(20 + at[1], abs=0.12)


@pytest.mark.parametrize("shape", SHAPES)
def test_coverage_agrees_with_fine_sampling(paint: Callable[..., Any], shape: Shape) -> None:
    exact = paint([(shape, 20.3, 19.6, 15.0)], size=(41, 41), mark=200.0, ground=0.0, blur_px=0) / 200
    assert np.abs(coverage(shape, 15.0, 41, (20.3, 19.6)) - exact).max() < (0.12 if shape == "circle" else 0.3)


def test_the_default_centre_is_that_of_the_picture() -> None:
    picture = coverage("circle", 9.0, 21)
    assert np.array_equal(picture, picture[::-1])
    assert np.array_equal(picture, picture.T)
