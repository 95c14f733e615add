from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.hdr.kernels import accumulate, linearise

ONE = np.ones((1, 1), np.float32)


@pytest.mark.parametrize(("dtype", "full"), [(np.uint8, 255.0), (np.uint16, 65535.0)])
def test_grey_levels_become_radiance_and_saturated_pixels_nan(dtype: type, full: float) -> None:
    pixels = np.array([[0, 100, 254, 255]], dtype) * dtype(1 if dtype is np.uint8 else 257)
    flat = np.array([[1.0, 0.5, 2.0, 1.0]] * 2, np.float32)[:1]
    out = np.empty((1, 4), np.float32)
    linearise(pixels, ONE * 2, flat[:1] * 1, (255 / full, 0.1, full), out)
    np.testing.assert_allclose(out[0, :3], np.array([-2, 98, 252]) * 0.1, rtol=1e-5)
    assert np.isnan(out[0, 3])


def test_maps_of_dark_and_flat_apply_pixel_by_pixel() -> None:
    pixels = np.full((2, 2), 50, np.uint8)
    dark, flat = np.array([[0, 10], [20, 0]], np.float32), np.array([[1, 1], [0.5, 0.0]], np.float32)
    out = np.empty((2, 2), np.float32)
    linearise(pixels, dark, flat, (1.0, 1.0, 255.0), out)
    np.testing.assert_allclose(out[[0, 0, 1], [0, 1, 0]], [50, 40, 60])
    assert np.isnan(out[1, 1])


def test_sums_are_weighted_by_the_inverse_variance_and_skip_nan() -> None:
    value = np.array([[1.0, np.nan, -0.1]], np.float32)
    total, weight = np.zeros((1, 3), np.float32), np.zeros((1, 3), np.float32)
    accumulate(value, np.array([[100.0]]), (2.25, 0.03), total, weight)
    accumulate(value * 2, np.array([[100.0]]), (2.25, 0.03), total, weight)
    assert weight[0, 0] == pytest.approx(1e4 / (2.25 + 3) + 1e4 / (2.25 + 6), rel=1e-5)
    assert total[0, 0] == pytest.approx(1e4 / (2.25 + 3) + 2e4 / (2.25 + 6), rel=1e-5)
    assert (total[0, 1], weight[0, 1]) == (0, 0)
    assert weight[0, 2] == pytest.approx(2e4 / 2.25, rel=1e-5)
