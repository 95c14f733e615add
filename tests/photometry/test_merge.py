from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.errors import InputError
from vaoi_station.photometry.flat_fields import FieldMaps
from vaoi_station.photometry.merge import merge
from vaoi_station.photometry.noise import NoiseModel
from vaoi_station.photometry.radiance import Radiance, Taken, to_radiance

NOISE = NoiseModel(1.5, 0.03)


def exposed(radiance: np.ndarray, exposure_us: float, seed: int) -> Radiance:
    signal = radiance * exposure_us
    noise = np.random.default_rng(seed).standard_normal(signal.shape) * np.sqrt(1.5**2 + 0.03 * signal)
    pixels = np.clip(np.round(signal + 2 + noise), 0, 255).astype(np.uint8)
    return to_radiance(pixels, Taken(exposure_us), FieldMaps(None, 2.0, NOISE))


def test_exposures_complement_each_other_and_sigma_is_honest() -> None:
    # Radiance over 2.4 decades: the long exposure saturates in the upper one.
    radiance = np.repeat(np.logspace(-1.4, 1.0, 60)[None], 400, 0)
    bright, dark = exposed(radiance, 250.0, 1), exposed(radiance, 15.0, 2)
    found = merge([bright, dark])
    assert not bright.valid[:, -1].any()
    assert found.valid.all()
    z = (found.value - radiance) / found.sigma
    assert 0.85 < float(np.sqrt((z**2).mean())) < 1.15
    bias = (found.value.mean(0) / radiance[0]) - 1
    assert np.abs(bias).max() < 0.03
    assert (found.sigma <= bright.sigma).all()


def test_places_that_no_frame_shows_are_nan() -> None:
    def one(valid: bool) -> Radiance:
        mask = np.array([[True, valid]])
        return Radiance(np.where(mask, np.float32(3), np.nan), np.where(mask, np.float32(1), np.inf), mask)

    found = merge([one(False), one(False)])
    assert found.value[0, 0] == 3
    assert found.sigma[0, 0] == pytest.approx(0.5**0.5)
    assert np.isnan(found.value[0, 1])
    assert not found.valid[0, 1]


def test_pictures_of_different_sizes_are_refused() -> None:
    grey = [to_radiance(np.zeros((h, 4), np.uint8), Taken(1.0), FieldMaps(None, 0.0, NOISE)) for h in (3, 5)]
    with pytest.raises(InputError, match="2 of these sizes: 4×3, 4×5"):
        merge(grey)
    with pytest.raises(InputError, match="0 of these sizes: none"):
        merge([])
