"""Reduced frames: means of blocks, those of the last pixels, and the border."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.mosaic.reduction import reduced


@pytest.mark.parametrize(("dtype", "colours"), [(np.uint8, ()), (np.uint16, (3,))])
@pytest.mark.parametrize("size", [(8, 12), (11, 13), (3, 9), (3, 2)])
def test_every_pixel_is_averaged(size: tuple[int, int], dtype: Any, colours: tuple[int, ...]) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (*size, *colours)).astype(dtype)
    found = reduced(pixels, 4)
    h, w = (-(-n // 4) for n in size)
    assert found.shape == (h + 2, w + 2, *colours)
    assert found.dtype == dtype
    for y, x in np.ndindex(h, w):
        mean = pixels[4 * y : 4 * y + 4, 4 * x : 4 * x + 4].mean((0, 1))
        assert np.abs(found[y + 1, x + 1] - mean).max() <= 0.5 + 1e-6


def test_values_continue_beside_the_outermost_blocks() -> None:
    found = reduced(np.arange(35, dtype=np.uint8).reshape(5, 7), 2)
    np.testing.assert_array_equal(found, np.pad(found[1:-1, 1:-1], 1, mode="edge"))
