"""The constants of patches have the properties that refinement relies on."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vaoi_station.stitching.matching.refinement import (
    ACROSS,
    BINOMIAL,
    BLUR_REACH,
    DOWN,
    FRACTIONS,
    INSIDE,
    NOISE_SHARE,
    PITCH_PX,
    SINC,
    TAPS,
    WINDOW_PX,
)

BLUR = np.array([*BINOMIAL[:0:-1], *BINOMIAL]) / 64


def test_the_blur_keeps_grey_levels_and_removes_the_highest_frequency() -> None:
    assert len(BLUR) == 2 * BLUR_REACH + 1
    assert BLUR.sum() == 1
    assert BLUR @ (-1.0) ** np.arange(len(BLUR)) == 0
    deviation = math.sqrt(float(BLUR @ (np.arange(len(BLUR)) - BLUR_REACH) ** 2))
    assert deviation == pytest.approx(1.22, abs=0.01)


def test_the_noise_share_is_the_sum_of_squared_weights() -> None:
    assert pytest.approx(float((np.outer(BLUR, BLUR) ** 2).sum())) == NOISE_SHARE


def test_the_interpolation_keeps_grey_levels_and_whole_pixels() -> None:
    assert SINC.shape == (FRACTIONS + 1, TAPS)
    assert SINC.sum(1) == pytest.approx(1, abs=1e-6)
    assert SINC[0] == pytest.approx([0, 0, 1, 0, 0, 0], abs=1e-7)
    assert SINC[-1] == pytest.approx([0, 0, 0, 1, 0, 0], abs=1e-7)
    assert pytest.approx(SINC[::-1, ::-1], abs=1e-6) == SINC


@pytest.mark.parametrize("period_px", [6.0, 10.0, 25.0])
def test_the_interpolation_shifts_waves_of_blurred_texture(period_px: float) -> None:
    at = np.arange(1 - TAPS // 2, TAPS // 2 + 1)
    fractions = np.linspace(0, 1, FRACTIONS + 1)
    exact = np.exp(2j * np.pi * fractions / period_px)
    found = SINC @ np.exp(2j * np.pi * at / period_px)
    shift_px = np.angle(found / exact) * period_px / (2 * np.pi)
    assert np.abs(shift_px).max() < 0.0025


def test_the_padding_of_lines_is_zero() -> None:
    for table in (INSIDE, ACROSS, DOWN):
        assert not table.reshape(WINDOW_PX, PITCH_PX)[:, WINDOW_PX:].any()
    assert INSIDE.sum() == WINDOW_PX**2
    for table in (ACROSS, DOWN):
        assert (table.min(), table.max()) == (-1, 1)
        assert table.sum() == pytest.approx(0, abs=1e-4)
    assert (
        pytest.approx(DOWN.reshape(WINDOW_PX, PITCH_PX)[:, :WINDOW_PX].T)
        == ACROSS.reshape(WINDOW_PX, PITCH_PX)[:, :WINDOW_PX]
    )
