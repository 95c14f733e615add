from __future__ import annotations

import numpy as np
import pytest

from tests.hdr.exposed_views import FRAME, NOISE, exposed
from vaoi_station.compiled import signatures
from vaoi_station.hdr.kernels import Source, add_shifted, by_depth, mean
from vaoi_station.hdr.merging import _add_turned, _source
from vaoi_station.photometry import FieldMaps

GROUP = np.zeros(1, np.int64)


def source(pixels: np.ndarray, dark: float, flat: np.ndarray, exposure: float) -> Source:
    full = 255.0 if pixels.dtype == np.uint8 else 65535.0
    darkness = np.full((1, 1), dark, np.float32)
    for array in (darkness, flat):
        array.flags.writeable = False
    return Source(*by_depth(pixels), darkness, flat, 255 / full, full, exposure, 2.25, 0.03)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_levels_become_radiance_without_saturated_pixels(dtype: type, turned: bool) -> None:
    pixels = np.full((40, 40), 100, dtype) * dtype(1 if dtype is np.uint8 else 257)
    pixels[20, 20] = np.iinfo(dtype).max
    flat = np.full((40, 40), 0.5, np.float32)
    flat[5, 5] = 0.01
    sums, frame = np.zeros((3, 1, 30, 30), np.float32), source(pixels, 2.0, flat, 10.0)
    matrix = np.array([[1.0, 0, 3], [0, 1, 3], [0, 0, 1]])
    if turned:
        _add_turned(frame, matrix, (0, 0, 30, 30), GROUP, sums)
    else:
        assert add_shifted(frame, matrix, (0, 0, 30, 30), GROUP, sums)
    unseen = sums[1, 0] == 0
    value = sums[0, 0] / np.where(unseen, 1, sums[1, 0])
    np.testing.assert_allclose(value[25:, 25:], 98 * 0.2, rtol=1e-5)
    assert unseen[15:20, 15:20].sum() >= 9
    assert unseen[2, 2]
    assert unseen.sum() < 40
    np.testing.assert_allclose(sums[1, 0, 25:, 25:], 25.0 / (2.25 + 0.03 * 98), rtol=1e-4)


def test_frames_of_8_and_16_bit_are_merged_by_the_same_code() -> None:
    for dtype in (np.uint8, np.uint16):
        frame = source(np.ones((20, 20), dtype), 1.0, np.ones((1, 1), np.float32), 10.0)
        assert add_shifted(frame, np.eye(3), (0, 0, 9, 9), GROUP, np.zeros((3, 1, 9, 9), np.float32))
    assert [name.rpartition(".")[2] for name, _ in signatures()].count("add_shifted") == 1


@pytest.mark.parametrize(
    ("beside_px", "line_step", "size"),
    [(0.0, (0.011, 0.997), (160, 57)), (30.0, (0.011, 0.997), (160, 57)), (0.0, (0.05, 1.6), (44, 42))],
)
def test_shifted_frames_are_merged_as_opencv_resamples_them(
    beside_px: float, line_step: tuple[float, float], size: tuple[int, int]
) -> None:
    """One pass gives the same as the steps one by one, in the frame and at its border, block by block.

    Also where pixels are not square, so that a block needs a larger part of the frame.
    """
    plain = exposed(0, 0, 250.0)  # the right half is saturated
    matrix = np.array([[1.002, line_step[0], 5.3 + beside_px], [-0.01, line_step[1], 4.6], [1e-7, 2e-7, 1.0]])
    width, height = size
    frame = _source(plain)
    sums, expected = np.zeros((2, 3, 3, height, width), np.float32)
    assert add_shifted(frame, matrix, (0, 0, width, height), np.array([0, 2]), sums)
    _add_turned(frame, matrix, (0, 0, width, height), np.array([0, 2]), expected)
    assert not sums[:, 1].any()
    assert not expected[:, 1].any()
    np.testing.assert_array_equal(sums[:, 0], sums[:, 2])
    (total, weight, noise), (value, own, noisy) = sums[:, 0], expected[:, 0]
    both = (weight > 0) & (own > 0)
    assert 800 < both.sum() < 0.99 * width * height
    # OpenCV counts pixels at the very border of the frame, and rounds places to a thousandth of a pixel or so.
    assert ((weight > 0) != (own > 0)).mean() < 0.01
    np.testing.assert_allclose(total[both] / weight[both], value[both] / own[both], rtol=0.01, atol=2e-3)
    np.testing.assert_allclose(weight[both], own[both], rtol=0.02)
    np.testing.assert_allclose(noise[both], noisy[both], rtol=0.02)


def test_turned_frames_are_left_to_opencv() -> None:
    quarter, sums = np.array([[0.0, 1, 10], [-1, 0, 60], [0, 0, 1]]), np.zeros((3, 1, 20, 20), np.float32)
    assert not add_shifted(_source(exposed(0, 0, 50.0)), quarter, (0, 0, 20, 20), GROUP, sums)
    assert not sums.any()


def test_frames_have_the_arrays_of_their_flat_field() -> None:
    flat, dark = FieldMaps(None, 3.0, NOISE).arrays
    assert (flat.tolist(), dark.tolist()) == ([[1.0]], [[3.0]])
    maps = np.full((FRAME[1], FRAME[0]), 2.0, np.float32)
    flat, dark = FieldMaps(maps, maps, NOISE).arrays
    assert flat.base is maps
    assert maps.flags.writeable
    assert not any(array.flags.writeable for array in (flat, dark))


def test_means_have_no_value_without_a_weight() -> None:
    out = np.empty((1, 2), np.float32)
    mean(np.array([[6.0, 0.0]], np.float32), np.array([[2.0, 0.0]], np.float32), out)
    assert out[0, 0] == 3
    assert np.isnan(out[0, 1])
