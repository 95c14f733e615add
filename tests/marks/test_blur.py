"""Blur of marks that are drawn exactly, against the blur with which they were drawn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from vaoi_station.marks.blur import measure_blur_px

PLACES = [(40.3, 39.6), (119.7, 41.2)]


@pytest.mark.parametrize("shape", ["circle", "square", "diamond", "cross"])
@pytest.mark.parametrize("blur_px", [0.6, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_the_blur_of_a_mark_is_measured(paint: Callable[..., Any], shape: str, blur_px: float, noise: float) -> None:
    size = 36.0
    picture = paint([(shape, x, y, size) for x, y in PLACES], size=(160, 80), blur_px=blur_px, noise=noise)
    measured = measure_blur_px(picture, np.array(PLACES), size)
    assert measured == pytest.approx(np.hypot(blur_px, 1 / np.sqrt(12)), rel=0.25, abs=0.2)


@pytest.mark.parametrize("noise", [3.0, 6.0, 10.0])
def test_noise_does_not_make_a_sharp_mark_look_blurred(paint: Callable[..., Any], noise: float) -> None:
    picture = paint([("circle", 40.0, 40.0, 20.0)], size=(80, 80), mark=90.0, ground=50.0, noise=noise)
    assert measure_blur_px(picture, np.array([(40.0, 40.0)]), 20.0) < 1.5
