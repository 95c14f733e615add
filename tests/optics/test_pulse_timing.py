from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.errors import InputError
from vaoi_station.optics import (
    achieved_multiplicity_v,
    capture_duration_s,
    lowest_frame_rate_hz,
    rows_per_board,
    spare_time_us,
    trigger_period_us,
)


def test_eight_frames_a_second_fall_short_of_the_papers_multiplicity() -> None:
    assert trigger_period_us(8) == 125000
    assert achieved_multiplicity_v(8, 1040, 100, 40) == pytest.approx(2.08)


@given(st.floats(1, 500), st.floats(1, 100), st.integers(100, 5000), st.floats(1, 9))
def test_multiplicity_inverts_equation_6(v: float, r: float, p_v: int, m_v: float) -> None:
    assert achieved_multiplicity_v(lowest_frame_rate_hz(v, r, p_v, m_v), p_v, v, r) == pytest.approx(m_v)


def test_exposure_and_readout_share_the_period() -> None:
    assert spare_time_us(1000, 300, 600) == pytest.approx(100)
    assert spare_time_us(1000, 300, 800) == pytest.approx(-100)
    assert spare_time_us(1000, 1000) == 0


def test_the_papers_five_seconds_are_forty_rows() -> None:
    assert capture_duration_s(474, 26, 100) == pytest.approx(5.0)
    assert rows_per_board(5.0, 8.0) == 40


def test_rounding_adds_no_row_and_a_remainder_does() -> None:
    assert rows_per_board(0.3, 10) == 3
    assert rows_per_board(0.1 + 0.2, 10) == 3
    assert rows_per_board(0.301, 10) == 4


@given(st.floats(10, 500), st.floats(5, 60), st.floats(20, 300), st.floats(1.0, 5), st.floats(0, 1))
def test_every_point_is_in_as_many_rows_as_promised(board: float, view: float, v: float, m_v: float, at: float) -> None:
    """Rows at 0, T, 2T, … since the leading edge came into view; a point `x` behind it is in view from x / v on."""
    rate = m_v * v / view
    rows = rows_per_board(capture_duration_s(board, view, v), rate)
    x = at * board
    seen = sum(-1e-9 <= k / rate * v - x <= view + 1e-9 for k in range(rows))
    assert seen >= math.floor(m_v)


def test_invalid_times_are_refused() -> None:
    with pytest.raises(InputError, match="frame_rate_hz is 0"):
        trigger_period_us(0)
    with pytest.raises(InputError, match="readout_us is -1, but must be a finite number, 0 or above"):
        spare_time_us(1000, 10, -1)
    with pytest.raises(InputError, match="board_mm"):
        capture_duration_s(0, 26, 100)
