from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.errors import InputError
from vaoi_station.optics import achieved_multiplicity_h, camera_pitch_mm, cameras_needed, field_of_view_mm


def test_the_paper_needs_a_little_more_than_its_12_cameras() -> None:
    assert cameras_needed(400, 40, 1.05, 1392) == pytest.approx(12.069, abs=5e-4)
    assert achieved_multiplicity_h(12, 1392, 400, 40) == pytest.approx(1.044)


@given(st.floats(50, 600), st.floats(5, 100), st.floats(1, 4), st.integers(500, 8000))
def test_the_next_whole_number_reaches_the_multiplicity_and_one_less_does_not(
    w: float, r: float, m_h: float, p_h: int
) -> None:
    n = math.ceil(cameras_needed(w, r, m_h, p_h))
    assert achieved_multiplicity_h(n, p_h, w, r) >= m_h * (1 - 1e-12)
    if n > 1:
        assert achieved_multiplicity_h(n - 1, p_h, w, r) < m_h


def test_views_side_by_side_end_where_the_board_ends() -> None:
    view = field_of_view_mm(1392, 40)
    pitch = camera_pitch_mm(12, 400, view)
    assert view == pytest.approx(34.8)
    assert 11 * pitch + view == pytest.approx(400)
    assert camera_pitch_mm(1, 400, view) == 0
    assert camera_pitch_mm(3, 30, view) == 0


def test_no_camera_is_refused() -> None:
    with pytest.raises(InputError, match="cameras is 0, but must be a finite number above 0"):
        achieved_multiplicity_h(0, 1392, 400, 40)
    with pytest.raises(InputError, match="width_mm is -1"):
        cameras_needed(-1, 40, 1, 1392)
