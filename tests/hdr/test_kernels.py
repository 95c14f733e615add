from __future__ import annotations

import numpy as np
import pytest

from tests.hdr.exposed_views import FRAME, NOISE, exposed
from vaoi_station.compiled import signatures
from vaoi_station.hdr.kernels import (
    SHARPENING_PX2,
    Source,
    accumulate,
    add_shifted,
    by_depth,
    linearise,
    mean,
    noise_factors,
)
from vaoi_station.hdr.merging import _block_scales, _source, _warped
from vaoi_station.photometry import FieldMaps
from vaoi_station.rendering.view import Tile

ONE = np.ones((1, 1), np.float32)


def source(pixels: np.ndarray, dark: np.ndarray, flat: np.ndarray, exposure: float) -> Source:
    full = 255.0 if pixels.dtype == np.uint8 else 65535.0
    for array in (dark, flat):
        array.flags.writeable = False
    return Source(*by_depth(pixels), dark, flat, 255 / full, full, exposure, 2.25, 0.03)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_levels_become_radiance_and_saturated_pixels_nan(dtype: type) -> None:
    pixels = np.array([[0, 0, 0, 0], [0, 100, 254, 255]], dtype) * dtype(1 if dtype is np.uint8 else 257)
    flat, out = np.array([[1.0] * 4, [1.0, 0.5, 2.0, 1.0]], np.float32), np.empty((1, 3), np.float32)
    linearise(source(pixels, ONE * 2, flat, 10.0), (1, 1, 4, 2), out)
    np.testing.assert_allclose(out[0, :2], np.array([196, 126]) * 0.1, rtol=1e-5)
    assert np.isnan(out[0, 2])


def test_frames_of_8_and_16_bit_are_merged_by_the_same_code() -> None:
    for dtype in (np.uint8, np.uint16):
        frame = source(np.ones((20, 20), dtype), ONE, ONE, 10.0)
        sums = np.zeros((3, 1, 9, 9), np.float32)
        assert add_shifted(frame, np.eye(3), (0, 0, 9, 9), np.zeros(1, np.int64), sums)
        linearise(frame, (0, 0, 9, 9), np.empty((9, 9), np.float32))
    compiled = [name.rpartition(".")[2] for name, _ in signatures()]
    assert (compiled.count("add_shifted"), compiled.count("linearise")) == (1, 1)


def test_maps_of_dark_and_flat_apply_pixel_by_pixel() -> None:
    pixels = np.full((2, 2), 50, np.uint8)
    dark, flat = np.array([[0, 10], [20, 0]], np.float32), np.array([[1, 1], [0.5, 0.0]], np.float32)
    out = np.empty((2, 2), np.float32)
    linearise(source(pixels, dark, flat, 1.0), (0, 0, 2, 2), out)
    np.testing.assert_allclose(out[[0, 0, 1], [0, 1, 0]], [50, 40, 60])
    assert np.isnan(out[1, 1])


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
    turned = np.array([[1.002, line_step[0], 5.3 + beside_px], [-0.01, line_step[1], 4.6], [1e-7, 2e-7, 1.0]])
    width, height = size
    plain.view.width, plain.view.height, plain.view.matrix = width, height, turned
    frame = _source(plain)
    sums = np.zeros((3, 3, height, width), np.float32)
    assert add_shifted(frame, turned, (0, 0, width, height), np.array([0, 2]), sums)
    value, factors = _warped(plain.view, frame, [Tile(0, 0, width, height, turned)])
    total, weight, noise = np.zeros((3, *value.shape), np.float32)
    accumulate((value, factors), _block_scales(plain.view, frame), (NOISE.read**2, NOISE.shot), (total, weight, noise))
    assert not sums[:, 1].any()
    np.testing.assert_array_equal(sums[:, 0], sums[:, 2])
    both = (sums[1, 0] > 0) & (weight > 0)
    assert 800 < both.sum() < 0.99 * width * height
    # OpenCV counts pixels at the very border of the frame, and rounds places to a thousandth of a pixel or so.
    assert ((sums[1, 0] > 0) != (weight > 0)).mean() < 0.01
    (found, own, noisy), expected = sums[:, 0, both], total[both] / weight[both]
    np.testing.assert_allclose(found / own, expected, rtol=0.01, atol=2e-3)
    np.testing.assert_allclose(own, weight[both], rtol=0.02)
    np.testing.assert_allclose(noisy, noise[both], rtol=0.02)


def test_turned_frames_are_left_to_opencv() -> None:
    quarter, sums = np.array([[0.0, 1, 10], [-1, 0, 60], [0, 0, 1]]), np.zeros((3, 1, 20, 20), np.float32)
    assert not add_shifted(_source(exposed(0, 0, 50.0)), quarter, (0, 0, 20, 20), np.zeros(1, np.int64), sums)
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


def test_sums_are_weighted_by_the_inverse_variance_and_skip_nan() -> None:
    value = np.array([[1.0, np.nan, -0.1]], np.float32)
    total, weight, noise = np.zeros((3, 1, 3), np.float32)
    factor = np.array([[1.0, 1.0, 0.5]], np.float32)
    for part in (value, value * 2):
        accumulate((part, factor), np.array([[100.0]]), (2.25, 0.03), (total, weight, noise))
    assert weight[0, 0] == pytest.approx(1e4 / (2.25 + 3) + 1e4 / (2.25 + 6), rel=1e-5)
    assert total[0, 0] == pytest.approx(1e4 / (2.25 + 3) + 2e4 / (2.25 + 6), rel=1e-5)
    assert (total[0, 1], weight[0, 1]) == (0, 0)
    assert weight[0, 2] == pytest.approx(2e4 / 2.25, rel=1e-5)
    np.testing.assert_allclose(noise, weight * factor, rtol=1e-5)


@pytest.mark.parametrize("at", [(3.0, 2.0), (3.25, 2.5), (3.9, 2.1)])
def test_sharpening_and_interpolation_multiply_noise_by_the_sum_of_their_squared_taps(at: tuple[float, float]) -> None:
    factors, taps = np.empty((1, 1), np.float32), []
    noise_factors(np.array([[1.0, 0, at[0]], [0, 1, at[1]], [0, 0, 1]]), factors)
    for f in np.array(at) % 1:
        taps.append(np.convolve([-SHARPENING_PX2 / 2, 1 + SHARPENING_PX2, -SHARPENING_PX2 / 2], [1 - f, f]))
    assert factors[0, 0] == pytest.approx((np.outer(*taps) ** 2).sum(), rel=1e-5)
