from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.errors import InputError
from vaoi_station.optics import (
    longest_exposure_us,
    lowest_frame_rate_hz,
    motion_blur_px,
    parallax_px,
    parallax_px_per_mm,
)

speeds = st.floats(1, 1000)
resolutions = st.floats(1, 200)


def test_equation_4_by_hand() -> None:
    """100 mm/s · 40 px/mm · 500 µs."""
    assert motion_blur_px(100, 40, 500) == pytest.approx(2.0)


def test_equation_5_gives_the_papers_exposure() -> None:
    assert longest_exposure_us(1, 100, 40) == pytest.approx(250)


@given(st.floats(0.1, 10), speeds, resolutions)
def test_equation_5_is_where_equation_4_is_just_met(blur: float, v: float, r: float) -> None:
    assert motion_blur_px(v, r, longest_exposure_us(blur, v, r)) == pytest.approx(blur)


def test_equation_6_gives_the_papers_frame_rate_before_rounding() -> None:
    assert lowest_frame_rate_hz(100, 40, 1040, 2.1) == pytest.approx(8.0769, abs=5e-5)


@given(speeds, resolutions, st.integers(100, 5000), st.integers(1, 5))
def test_equation_6_shows_every_point_that_often(v: float, r: float, p_v: int, m_v: int) -> None:
    """Frames every 1/t, each p_v / r long: a point fixed on the board is inside m_v of them."""
    step_mm, view_mm = v / lowest_frame_rate_hz(v, r, p_v, m_v), p_v / r
    start = 0.37 * step_mm
    assert sum(0 <= start + k * step_mm < view_mm for k in range(10)) == m_v


def test_parallax_from_two_rays() -> None:
    """A point 12 mm high, seen from 400 mm at 0 and at 50 mm of travel: where its rays meet the board."""
    h, s, d, r = 12.0, 50.0, 400.0, 40.0
    at = [x + (20.0 - x) * d / (d - h) for x in (0.0, -s)]
    seen = [(ground - camera) * r for ground, camera in zip(at, (0.0, -s), strict=True)]
    assert parallax_px(h, s, d, r) == pytest.approx(seen[1] - seen[0] - r * s)


def test_parallax_per_mm_is_the_slope_at_the_board() -> None:
    assert parallax_px_per_mm(12.5, 483, 40) == pytest.approx(parallax_px(1e-4, 12.5, 483, 40) / 1e-4, rel=1e-6)
    assert parallax_px_per_mm(12.5, 483, 40) == pytest.approx(1.035, abs=1e-3)


@pytest.mark.parametrize("bad", [0, -3, float("nan")])
def test_zero_and_invalid_quantities_are_refused(bad: float) -> None:
    with pytest.raises(InputError, match="speed_mm_s"):
        motion_blur_px(bad, 40, 250)
    with pytest.raises(InputError, match="exposure_us"):
        motion_blur_px(100, 40, bad)
    with pytest.raises(InputError, match="blur_px"):
        longest_exposure_us(bad, 100, 40)
    with pytest.raises(InputError, match="sensor_px_v"):
        lowest_frame_rate_hz(100, 40, bad, 2)
    with pytest.raises(InputError, match="multiplicity_v"):
        lowest_frame_rate_hz(100, 40, 1040, bad)


def test_heights_reach_neither_below_the_board_nor_up_to_the_camera() -> None:
    with pytest.raises(InputError, match="height_mm is -1, but must be a finite number, 0 or above"):
        parallax_px(-1, 12, 400, 40)
    with pytest.raises(InputError, match="height_mm is 400, but must be below the distance, 400 mm"):
        parallax_px(400, 12, 400, 40)
