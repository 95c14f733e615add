"""Gains from overlaps: flicker, the fall-off of the lenses and the dark level are found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.mosaic.conftest import DARK, SIZE, Film, Filmed
from vaoi_station.mosaic.gains import FieldCache, estimate_gains, survey
from vaoi_station.mosaic.reduction import Reduced, reduced
from vaoi_station.photometry import FlatFields
from vaoi_station.steps import completed


def test_flicker_field_and_dark_level_are_estimated(film: Film) -> None:
    board = film(flicker=0.03, step_mm=6.0, vignette=0.5)
    found = list(survey(board.taken, board.read, board.projector, board.base, FieldCache(FlatFields.none())))
    gains = completed(estimate_gains(found, board.cameras, calibrated=False))
    assert gains.dark == pytest.approx(DARK, abs=1.5)
    lamps = np.random.default_rng(3)
    expected = []
    for _ in range(5):
        expected.append(1 + lamps.normal(0, 0.03))
        lamps.normal(0, 0.5, (2, SIZE[1], SIZE[0]))
    # A gain that grows from row to row looks like a field with a slope: overlaps cannot distinguish them.
    rows = np.arange(5)
    difference = np.array([gains.frame[0, j] for j in range(5)]) - np.log(expected)
    assert np.abs(difference - np.polyval(np.polyfit(rows, difference, 1), rows)).max() < 0.006
    middle, edge = (float(np.exp(gains.log_field(0, board.cameras[0], np.array([159.5, y])))) for y in (119.5, 10.0))
    # the lamp falls off by 0.5 · 2 · 0.458² across the frame
    assert edge / middle == pytest.approx(1 - 0.21, abs=0.05)


def test_missing_frames_and_saturated_places_are_left_out(board: Filmed) -> None:
    frames = dict(board.frames)
    del frames[0, 1]
    frames[1, 1] = np.full_like(frames[1, 1], 255)
    found = survey(
        board.taken, lambda i, j: frames.get((i, j)), board.projector, board.base, FieldCache(FlatFields.none())
    )
    by_key = {(s.taken.camera, s.taken.row): s for s in found}
    assert (0, 1) not in by_key
    assert not np.isfinite(by_key[1, 1].values).any()


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
