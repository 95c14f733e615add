from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.photometry.darkness import measure_darkness, uncut_normal, without_noise


@pytest.mark.parametrize(("level", "sigma"), [(2.0, 1.5), (0.5, 1.0), (20.0, 2.0)])
def test_the_dark_level_is_right_although_grey_levels_are_cut_off_at_zero(level: float, sigma: float) -> None:
    rng = np.random.default_rng(1)
    frames = [np.clip(np.round(rng.normal(level, sigma, (96, 128))), 0, 255).astype(np.float32) for _ in range(4)]
    found = measure_darkness(frames)
    assert found.level == pytest.approx(level, abs=0.06)
    assert found.read == pytest.approx(sigma, abs=0.06)
    assert found.map is None


def test_dark_columns_and_hot_pixels_are_kept_in_a_map() -> None:
    rng = np.random.default_rng(2)
    pattern = np.full((96, 128), 5.0)
    pattern[:, 64:] += 2.0
    pattern[30, 40] = 60.0
    frames = [np.round(pattern + rng.normal(0, 1.0, pattern.shape)).clip(0).astype(np.float32) for _ in range(8)]
    found = measure_darkness(frames)
    assert found.map is not None
    assert found.map[:, 90:].mean() - found.map[:, :40].mean() == pytest.approx(2.0, abs=0.1)
    assert found.map[30, 40] == pytest.approx(60, abs=4)


def test_one_single_grey_level_has_the_noise_of_quantisation() -> None:
    assert uncut_normal(np.full(100, 4.0, np.float32)) == (4.0, 0.3)


def test_noise_is_removed_and_dust_is_kept() -> None:
    rng = np.random.default_rng(3)
    residual = rng.normal(0, 0.01, (80, 80)).astype(np.float32)
    residual[40:44, 40:44] -= 0.2
    found = without_noise(residual, np.float32(1e-4))
    assert found[:30].std() < 0.002
    assert found[41:43, 41:43].mean() == pytest.approx(-0.2, abs=0.03)
