from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.photometry.flat_fields import FieldMaps
from vaoi_station.photometry.noise import NoiseModel
from vaoi_station.photometry.radiance import Taken, is_saturated, to_radiance

PLAIN = FieldMaps(None, 2.0, NoiseModel(1.5, 0.03))


def test_radiance_is_signal_over_flat_exposure_and_gain() -> None:
    flat = np.linspace(0.5, 1.5, 12, dtype=np.float32).reshape(3, 4)
    pixels = np.full((3, 4), 102, np.uint8)
    found = to_radiance(pixels, Taken(50.0, 2.0), FieldMaps(flat, 2.0, NoiseModel(1.5, 0.03)))
    np.testing.assert_allclose(found.value, 100 / (flat * 100), rtol=1e-5)
    np.testing.assert_allclose(found.sigma, np.sqrt(1.5**2 + 0.03 * 2 * 100) / (flat * 100), rtol=1e-5)
    assert found.valid.all()
    assert found.value.dtype == found.sigma.dtype == np.float32


def test_16_bits_and_colour_have_the_unit_of_8_bits() -> None:
    grey = np.full((5, 5), 60, np.uint8)
    wide = grey.astype(np.uint16) * 257
    colour = np.repeat(grey[:, :, None], 3, 2)
    values = [to_radiance(p, Taken(10.0), PLAIN).value for p in (grey, wide, colour)]
    np.testing.assert_allclose(values, 5.8, rtol=1e-4)


@pytest.mark.parametrize(("dtype", "full"), [(np.uint8, 255), (np.uint16, 65535)])
def test_saturated_pixels_and_their_neighbours_are_invalid(dtype: type, full: int) -> None:
    pixels: NDArray[Any] = np.full((7, 9), full // 2, dtype)
    pixels[3, 4] = full
    found = to_radiance(pixels, Taken(10.0), PLAIN)
    assert (~found.valid).sum() == 9
    assert np.isnan(found.value[2:5, 3:6]).all()
    assert np.isinf(found.sigma[2:5, 3:6]).all()
    assert np.isfinite(found.value[found.valid]).all()


def test_one_saturated_colour_is_enough() -> None:
    pixels = np.zeros((5, 5, 3), np.uint8)
    pixels[0, 0, 2] = 255
    assert is_saturated(pixels).sum() == 4
    assert not is_saturated(pixels[2:]).any()


def test_a_part_of_the_frame_has_the_radiance_of_the_whole() -> None:
    flat = np.random.default_rng(1).uniform(0.7, 1.2, (8, 10)).astype(np.float32)
    maps = FieldMaps(flat, flat * 3, NoiseModel())
    pixels = np.full((8, 10), 80, np.uint8)
    area = np.s_[2:6, 3:9]
    part = to_radiance(pixels[area], Taken(5.0), maps.part(*area))
    np.testing.assert_array_equal(part.value, to_radiance(pixels, Taken(5.0), maps).value[area])
    assert FieldMaps(None, 2.0, NoiseModel()).part(*area).flat is None


def test_a_flat_field_of_another_size_is_refused() -> None:
    maps = FieldMaps(np.ones((4, 4), np.float32), 0.0, NoiseModel())
    with pytest.raises(InputError, match="frame has 6×5 px, but its flat field has 4×4 px"):
        to_radiance(np.zeros((5, 6), np.uint8), Taken(1.0), maps)


def test_pixels_that_see_nothing_are_invalid() -> None:
    flat = np.ones((3, 3), np.float32)
    flat[1, 1] = 0
    assert not to_radiance(np.full((3, 3), 9, np.uint8), Taken(1.0), FieldMaps(flat, 0.0, NoiseModel())).valid[1, 1]
