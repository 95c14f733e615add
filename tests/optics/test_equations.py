from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.errors import InputError
from vaoi_station.optics import (
    achieved_multiplicity_h,
    achieved_multiplicity_v,
    airy_disc_px,
    buffer_bytes,
    camera_pitch_mm,
    cameras_needed,
    capture_duration_s,
    data_rate_mbit_s,
    depth_of_field_mm,
    f_number,
    focal_length_mm,
    frame_bytes,
    longest_exposure_us,
    lowest_frame_rate_hz,
    motion_blur_px,
    parallax_px,
    rows_per_board,
    spare_time_us,
    working_distance_mm,
)

lenses, resolutions, speeds = st.floats(5, 200), st.floats(2, 200), st.floats(1, 1000)
sensors = st.tuples(st.floats(500, 10000), resolutions, st.floats(3, 40))


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
    assert 11 * camera_pitch_mm(12, 400, 34.8) + 34.8 == pytest.approx(400)
    assert camera_pitch_mm(1, 400, 34.8) == camera_pitch_mm(3, 30, 34.8) == 0


def test_equation_1_gives_the_papers_focal_length() -> None:
    assert focal_length_mm(500, 1392, 40, 6.4) == pytest.approx(77.7, abs=0.05)


def test_the_75_mm_lens_has_a_distance_of_483_mm() -> None:
    assert working_distance_mm(75, 1392, 40, 6.4) == pytest.approx(483, abs=0.5)


@given(lenses, sensors)
def test_working_distance_inverts_equation_1(f: float, sensor: tuple[float, float, float]) -> None:
    assert focal_length_mm(working_distance_mm(f, *sensor), *sensor) == pytest.approx(f)


def test_equation_2_is_the_near_limit_of_a_thin_lens() -> None:
    """A point at the near limit is blurred to exactly c by the aperture f / N."""
    d, f, n, c = 483.0, 75.0, 16.0, 0.01
    near = d - depth_of_field_mm(d, f, n, c)
    image_of_board, image_of_point = 1 / (1 / f - 1 / d), 1 / (1 / f - 1 / near)
    blur = (f / n) * (image_of_point - image_of_board) / image_of_point
    assert blur == pytest.approx(c, rel=1e-9)


@given(st.floats(0.1, 50), st.floats(1.5, 20), lenses, st.floats(0.001, 0.1))
def test_equation_3_inverts_equation_2(depth: float, ratio: float, f: float, c: float) -> None:
    d = f * ratio + depth
    assert depth_of_field_mm(d, f, f_number(depth, d, f, c), c) == pytest.approx(depth)


def test_the_airy_disc_at_unit_magnification() -> None:
    """f/8 works as f/16 at 1:1: 2.44 · 0.55 µm · 16 = 21.5 µm on pixels of 10 µm."""
    assert airy_disc_px(8, 200, 100, sensor_px_h=1000, sensor_width_mm=10) == pytest.approx(2.1472)


def test_equation_4_by_hand() -> None:
    """100 mm/s · 40 px/mm · 500 µs."""
    assert motion_blur_px(100, 40, 500) == pytest.approx(2.0)


def test_equation_5_gives_the_papers_exposure() -> None:
    assert longest_exposure_us(1, 100, 40) == pytest.approx(250)


@given(speeds, resolutions, st.integers(100, 5000), st.integers(1, 5))
def test_equation_6_shows_every_point_that_often(v: float, r: float, p_v: int, m_v: int) -> None:
    """Frames every 1/t, each p_v / r long: a point fixed on the board is inside m_v of them."""
    step_mm, view_mm = v / lowest_frame_rate_hz(v, r, p_v, m_v), p_v / r
    start = 0.37 * step_mm
    assert sum(0 <= start + k * step_mm < view_mm for k in range(10)) == m_v


@given(speeds, resolutions, st.integers(100, 5000), st.floats(1, 9))
def test_multiplicity_inverts_equation_6(v: float, r: float, p_v: int, m_v: float) -> None:
    assert achieved_multiplicity_v(lowest_frame_rate_hz(v, r, p_v, m_v), p_v, v, r) == pytest.approx(m_v)


def test_parallax_from_two_rays() -> None:
    """A point 12 mm high, seen from 400 mm at 0 and at 50 mm of travel: where its rays meet the board."""
    h, s, d, r = 12.0, 50.0, 400.0, 40.0
    at = [x + (20.0 - x) * d / (d - h) for x in (0.0, -s)]
    seen = [(ground - camera) * r for ground, camera in zip(at, (0.0, -s), strict=True)]
    assert parallax_px(h, s, d, r) == pytest.approx(seen[1] - seen[0] - r * s)


def test_exposure_and_readout_share_the_period() -> None:
    assert spare_time_us(1000, 300, 600) == pytest.approx(100)
    assert spare_time_us(1000, 300, 800) == pytest.approx(-100)
    assert spare_time_us(1000, 1000) == 0


def test_the_papers_five_seconds_are_forty_rows() -> None:
    assert capture_duration_s(474, 26, 100) == pytest.approx(5.0)
    assert rows_per_board(5.0, 8.0) == 40


@given(st.floats(10, 500), st.floats(5, 60), st.floats(20, 300), st.floats(1.0, 5), st.floats(0, 1))
def test_every_point_is_in_as_many_rows_as_promised(board: float, view: float, v: float, m_v: float, at: float) -> None:
    """Rows at 0, T, 2T, … since the leading edge came into view; a point `x` behind it is in view from x / v on."""
    rate = m_v * v / view
    rows = rows_per_board(capture_duration_s(board, view, v), rate)
    x = at * board
    seen = sum(-1e-9 <= k / rate * v - x <= view + 1e-9 for k in range(rows))
    assert seen >= math.floor(m_v)


def test_the_papers_data_rate_is_in_decimal_megabits() -> None:
    assert data_rate_mbit_s(12, 1392, 1040, 8, 8) == pytest.approx(1111.8, abs=0.05)


def test_frames_and_buffers() -> None:
    assert frame_bytes(1392, 1040, 16) == 2 * 1392 * 1040
    assert frame_bytes(3, 3, 12) == 14
    assert buffer_bytes(12, 40, 1392 * 1040, runs=3) == 3 * 694_886_400


@pytest.mark.parametrize("bad", [0, -1, float("nan"), float("inf"), True, "75"])
def test_an_invalid_quantity_is_refused_by_name(bad: float) -> None:
    with pytest.raises(InputError, match=f"optics: distance_mm is {bad!r}, but must be a finite number above 0"):
        focal_length_mm(bad, 1392, 40, 6.4)
    with pytest.raises(InputError, match=f"optics: sensor_width_mm is {bad!r}"):
        focal_length_mm(500, 1392, 40, sensor_width_mm=bad)


@pytest.mark.parametrize(
    ("compute", "complaint"),
    [
        (lambda: depth_of_field_mm(75, 75, 8, 0.01), "distance_mm is 75, but must be above the focal length, 75 mm"),
        (lambda: f_number(483, 483, 75, 0.01), "depth_of_field_mm is 483, but must be below the distance, 483 mm"),
        (lambda: parallax_px(-1, 12, 400, 40), "height_mm is -1, but must be a finite number, 0 or above"),
        (lambda: parallax_px(400, 12, 400, 40), "height_mm is 400, but must be below the distance, 400 mm"),
        (lambda: spare_time_us(1000, 10, -1), "readout_us is -1, but must be a finite number, 0 or above"),
    ],
)
def test_quantities_that_contradict_each_other_are_refused(compute: Callable[[], float], complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        compute()
