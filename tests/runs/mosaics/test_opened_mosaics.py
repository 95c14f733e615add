"""Mosaics in memory: no more plans and bytes of overviews than the limits allow."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.runs.mosaics.opened_mosaics import (
    MOST_BYTES,
    OpenedMosaic,
    OpenedMosaics,
    Overview,
    PlannedMosaic,
    halved,
)


def opened() -> OpenedMosaic:
    anything: Any = SimpleNamespace()
    return OpenedMosaic(anything, anything)


def planned(share: float) -> PlannedMosaic:
    """A plan with an overview that takes a share of the memory for all."""
    anything: Any = SimpleNamespace(nbytes=int(share * MOST_BYTES))
    return PlannedMosaic(anything, anything)


def test_overviews_share_a_limit_of_memory() -> None:
    mosaics = OpenedMosaics()
    used = [mosaics.use(n, opened(), asked=True) for n in range(4)]
    for one in used[:3]:
        mosaics.keep(one, planned(0.4))
    assert [mosaics.get(n) is not None for n in range(4)] == [False, True, True, True]
    mosaics.keep(used[3], planned(1.2))
    assert [mosaics.get(n) is not None for n in range(4)] == [False, False, False, True]


def means(picture: NDArray[Any], factor: int) -> NDArray[np.float64]:
    """Average the shown pixels of blocks; 0 where none is shown."""
    h, w = picture.shape[:2]
    whole = np.zeros((-(-h // factor) * factor, -(-w // factor) * factor, *picture.shape[2:]))
    whole[:h, :w] = picture
    blocks = whole.reshape(whole.shape[0] // factor, factor, whole.shape[1] // factor, factor, *picture.shape[2:])
    return np.asarray(blocks.sum((1, 3)) / np.maximum((blocks > 0).sum((1, 3)), 1))


def picture(shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """Return noise in which a part, and single pixels, are not shown."""
    g = np.random.default_rng(1)
    found = g.integers(1, 250, shape).astype(dtype)
    found[: shape[0] // 3, : shape[1] // 2] = 0
    found[g.random(shape[:2]) < 0.01] = 0
    return found


@pytest.mark.parametrize(("shape", "dtype"), [((37, 41), np.uint8), ((6, 5, 3), np.uint16), ((1, 1), np.uint8)])
def test_a_pixel_is_the_mean_of_the_shown_ones(shape: tuple[int, ...], dtype: Any) -> None:
    pixels = picture(shape, dtype)
    half = halved(pixels)
    assert half.dtype == dtype
    assert half.shape == (-(-shape[0] // 2), -(-shape[1] // 2), *shape[2:])
    assert np.abs(half - means(pixels, 2)).max() <= 0.5
    np.testing.assert_array_equal(half == 0, means(pixels, 2) == 0)


@pytest.mark.parametrize("shape", [(1200, 700), (801, 1026, 3), (200, 100)])
def test_each_level_is_the_half_of_the_one_before(shape: tuple[int, ...]) -> None:
    pixels = picture(shape, np.uint8)
    overview, expected = Overview(pixels, 2), pixels
    for reduction in (2, 4, 8, 16, 512, 2048):
        level = overview.level(reduction)
        assert level is not None
        while len(expected) > -(-shape[0] * 2 // reduction):
            expected = halved(expected)
        np.testing.assert_array_equal(level, expected)
    assert overview.nbytes < pixels.size * 1.35
    np.testing.assert_array_equal(overview.cut(4, (10, 20, 30, 25)), halved(pixels)[20:25, 10:30])
