"""Pixels of one colour lie side by side, and come back to their places."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.plant.archive.frames.bayer import in_order, sorted_by_colour


def test_the_four_colours_are_the_four_quarters() -> None:
    y, x = np.mgrid[:4, :6]
    colours = (2 * (y % 2) + x % 2).astype(np.uint16)
    assert sorted_by_colour(colours).tolist() == [[0] * 3 + [1] * 3] * 2 + [[2] * 3 + [3] * 3] * 2


@pytest.mark.parametrize("shape", [(4, 6), (5, 7), (1, 3), (3, 1)])
def test_pixels_come_back_to_their_places(shape: tuple[int, int]) -> None:
    plane = np.arange(shape[0] * shape[1], dtype=np.uint16).reshape(shape)
    assert np.array_equal(in_order(sorted_by_colour(plane)), plane)
