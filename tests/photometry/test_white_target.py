from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.photometry.white_target import combine

H, W = 96, 128


def rows(count: int, pattern: NDArray[np.float64], seed: int = 1) -> list[NDArray[np.float32]]:
    rng = np.random.default_rng(seed)
    noise = np.sqrt(1.5**2 + 0.03 * pattern)
    return [(pattern + rng.standard_normal(pattern.shape) * noise).astype(np.float32) for _ in range(count)]


def vignette() -> NDArray[np.float64]:
    x, y = np.meshgrid(np.linspace(-1, 1, W), np.linspace(-1, 1, H))
    return np.asarray(150 * (1 - 0.2 * (x**2 + y**2)))


def test_four_rows_give_the_surface_to_a_few_thousandths() -> None:
    found = combine(rows(4, vignette()), [250.0] * 4)
    error = found.surface * 250 / vignette() - 1
    assert float(np.sqrt((error**2).mean())) < 0.003
    assert abs(error[:4].mean()) < 0.003
    assert found.structure < 0.01
    assert found.motion < 0.01
    np.testing.assert_allclose(found.variances, 1.5**2 + 0.03 * found.signals, rtol=0.12)


def test_dust_on_the_lens_stays_and_dust_on_the_target_goes() -> None:
    pattern = vignette()
    pattern[20:24, 30:34] *= 0.8
    taken = rows(6, pattern)
    taken[2][60:64, 80:84] *= 0.5
    found = combine(taken, [250.0] * 6).surface * 250 / vignette()
    assert found[21:23, 31:33].mean() == pytest.approx(0.8, abs=0.02)
    assert found[60:64, 80:84].mean() == pytest.approx(1.0, abs=0.01)


def test_flickering_rows_and_other_exposures_are_scaled() -> None:
    taken = [r * f for r, f in zip(rows(4, vignette()), (0.5, 0.51, 0.5, 0.49), strict=True)]
    found = combine(taken, [125.0] * 4)
    assert found.flicker == pytest.approx(0.02, abs=0.004)
    assert found.level == pytest.approx(vignette().mean() / 250, rel=0.005)


def test_a_board_is_structured_at_rest_and_moves_when_it_moves() -> None:
    board = vignette() * np.kron(np.random.default_rng(4).uniform(0.5, 1, (12, 16)), np.ones((8, 8)))
    assert combine(rows(4, board), [250.0] * 4).structure > 0.08
    moving = [r for shift in range(0, 60, 15) for r in rows(1, np.roll(board, shift, 0), shift)]
    assert combine(moving, [250.0] * 4).motion > 0.08
