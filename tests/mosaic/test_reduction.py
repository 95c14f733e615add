"""Reduced frames: means and largest pixels of blocks, those of the last pixels, frames in two steps, and the border."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.mosaic.reduction import BORDER_PX, Reduced, reduced


def noise(size: tuple[int, int], dtype: Any = np.uint8, colours: tuple[int, ...] = ()) -> Reduced:
    most = np.iinfo(dtype).max
    pixels = np.random.default_rng(0).integers(0, most, (*size, *colours), dtype, endpoint=True)
    return Reduced(pixels, pixels)


@pytest.mark.parametrize(("dtype", "colours"), [(np.uint8, ()), (np.uint8, (3,)), (np.uint16, ()), (np.uint16, (3,))])
@pytest.mark.parametrize("size", [(8, 12), (11, 13), (3, 9), (3, 2), (70, 129)])
@pytest.mark.parametrize("factor", [2, 4, 32])
def test_every_pixel_counts(size: tuple[int, int], dtype: Any, colours: tuple[int, ...], factor: int) -> None:
    picture = noise(size, dtype, colours)
    found = reduced(picture, factor)
    h, w = (-(-n // factor) for n in size)
    assert found.means.shape == found.largest.shape == (h, w, *colours)
    assert found.means.dtype == found.largest.dtype == dtype
    for y, x in np.ndindex(h, w):
        block = picture.means[factor * y : factor * (y + 1), factor * x : factor * (x + 1)]
        assert np.abs(found.means[y, x] - block.mean((0, 1))).max() <= 0.5 + 1e-3
        np.testing.assert_array_equal(found.largest[y, x], block.max((0, 1)))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_bright_blocks_do_not_overflow(dtype: Any) -> None:
    pixels = np.full((128, 128), np.iinfo(dtype).max, dtype)
    for factor in (16, 32, 128):
        assert (reduced(Reduced(pixels, pixels), factor).means == pixels[0, 0]).all()


def test_a_part_of_a_frame_is_reduced_as_the_whole() -> None:
    picture = noise((24, 32))
    whole, part = reduced(picture, 4), reduced(picture.part((8, 4, 24, 16)), 4)
    np.testing.assert_array_equal(part.means, whole.means[1:4, 2:6])


def test_two_steps_give_the_means_of_one_but_for_rounding() -> None:
    picture = noise((64, 96))
    one, two = reduced(picture, 16), reduced(reduced(picture, 8), 2)
    assert np.abs(one.means.astype(int) - two.means).max() <= 1
    np.testing.assert_array_equal(one.largest, two.largest)


def test_values_continue_beside_the_outermost_blocks() -> None:
    picture = noise((3, 4))
    for part, found in zip(picture, picture.bordered(), strict=True):
        np.testing.assert_array_equal(found, np.pad(part, BORDER_PX, mode="edge"))
