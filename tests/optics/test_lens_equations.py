from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.errors import InputError
from vaoi_station.optics import airy_disc_px, depth_of_field_mm, f_number, focal_length_mm, working_distance_mm

lenses = st.floats(5, 200)
resolutions = st.floats(2, 200)
sensors = st.tuples(st.floats(500, 10000), resolutions, st.floats(3, 40))


def test_equation_1_gives_the_papers_focal_length() -> None:
    assert focal_length_mm(500, 1392, 40, 6.4) == pytest.approx(77.7, abs=0.05)


def test_equation_1_by_similar_triangles() -> None:
    """A lens at twice its focal length from the board shows it at its own size."""
    assert focal_length_mm(100, sensor_px_h=1000, resolution_px_per_mm=100, sensor_width_mm=10) == pytest.approx(50)


def test_the_75_mm_lens_has_a_distance_of_483_mm() -> None:
    assert working_distance_mm(75, 1392, 40, 6.4) == pytest.approx(483, abs=0.5)


@given(lenses, sensors)
def test_working_distance_inverts_equation_1(f: float, sensor: tuple[float, float, float]) -> None:
    assert focal_length_mm(working_distance_mm(f, *sensor), *sensor) == pytest.approx(f)


def test_equation_2_by_hand() -> None:
    """d = 500, f = 100, N = 10, c = 0.01: 500 − 500·10⁴ / (10⁴ + 0.1·400) = 500·40 / 10040."""
    assert depth_of_field_mm(500, 100, 10, 0.01) == pytest.approx(500 * 40 / 10040)


def test_equation_2_is_the_near_limit_of_a_thin_lens() -> None:
    """A point at the near limit is blurred to exactly c by the aperture f / N."""
    d, f, n, c = 483.0, 75.0, 16.0, 0.01
    near = d - depth_of_field_mm(d, f, n, c)
    image_of_board, image_of_point = 1 / (1 / f - 1 / d), 1 / (1 / f - 1 / near)
    blur = (f / n) * (image_of_point - image_of_board) / image_of_point
    assert blur == pytest.approx(c, rel=1e-9)


def test_equation_3_by_hand() -> None:
    """d_f = 10, d = 500, f = 100, c = 0.01: 10·10⁴ / (0.01·400·490)."""
    assert f_number(10, 500, 100, 0.01) == pytest.approx(1e5 / 1960)


@given(st.floats(0.1, 50), st.floats(1.5, 20), lenses, st.floats(0.001, 0.1))
def test_equation_3_inverts_equation_2(depth: float, ratio: float, f: float, c: float) -> None:
    d = f * ratio + depth
    assert depth_of_field_mm(d, f, f_number(depth, d, f, c), c) == pytest.approx(depth)


def test_the_airy_disc_at_unit_magnification() -> None:
    """f/8 works as f/16 at 1:1: 2.44 · 0.55 µm · 16 = 21.5 µm on pixels of 10 µm."""
    assert airy_disc_px(8, 200, 100, sensor_px_h=1000, sensor_width_mm=10) == pytest.approx(2.1472)


@pytest.mark.parametrize("bad", [0, -1, float("nan"), float("inf"), True, "75"])
@pytest.mark.parametrize("place", range(4))
def test_equation_1_refuses_invalid_lengths(bad: float, place: int) -> None:
    given_values: list[float] = [500, 1392, 40, 6.4]
    given_values[place] = bad
    name = ["distance_mm", "sensor_px_h", "resolution_px_per_mm", "sensor_width_mm"][place]
    with pytest.raises(InputError, match=f"optics: {name} is {bad!r}, but must be a finite number above 0"):
        focal_length_mm(*given_values)


def test_a_board_inside_the_focal_length_is_refused() -> None:
    with pytest.raises(InputError, match="distance_mm is 75, but must be above the focal length, 75 mm"):
        depth_of_field_mm(75, 75, 8, 0.01)
    with pytest.raises(InputError, match="distance_mm is 50, but must be above the focal length"):
        f_number(10, 50, 75, 0.01)
    with pytest.raises(InputError, match="distance_mm is 50"):
        airy_disc_px(8, 50, 75, 1000, 10)


def test_a_depth_that_reaches_the_lens_is_refused() -> None:
    with pytest.raises(InputError, match="depth_of_field_mm is 483, but must be below the distance, 483 mm"):
        f_number(483, 483, 75, 0.01)


def test_no_circle_of_confusion_no_aperture() -> None:
    with pytest.raises(InputError, match="circle_of_confusion_mm is 0"):
        f_number(10, 483, 75, 0)
