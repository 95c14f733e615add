"""Differences of two images."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.errors import InputError
from vaoi_station.rendering.difference import subtract


@pytest.mark.parametrize(("dtype", "middle"), [(np.uint8, 128), (np.uint16, 32768)])
def test_equal_images_give_middle_grey(dtype: Any, middle: int) -> None:
    image = np.arange(200, dtype=dtype).reshape(10, 20)
    assert (subtract(image, image) == middle).all()
    assert subtract(image, image).dtype == dtype


def test_one_level_is_two_of_the_images_and_exposures_are_made_equal() -> None:
    bright, dark = np.full((2, 2), 100, np.uint8), np.full((2, 2), 20, np.uint8)
    assert subtract(bright, dark)[0, 0] == 128 + 40
    assert subtract(dark, bright)[0, 0] == 128 - 40
    assert subtract(bright, dark, ratio=5.0)[0, 0] == 128
    extremes = subtract(np.full((1, 1, 3), 255, np.uint8), np.zeros((1, 1, 3), np.uint8))
    assert extremes.tolist() == [[[255, 255, 255]]]


def test_images_of_different_kind_are_refused() -> None:
    with pytest.raises(InputError, match=r"uint8.*uint16 cannot be subtracted"):
        subtract(np.zeros((2, 2), np.uint8), np.zeros((2, 2), np.uint16))
