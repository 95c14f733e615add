from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.board_data.design import Box, Part, Placement, body_of, box_around, normalised, rotated


def test_the_centre_of_a_turned_part_follows_its_body() -> None:
    part = Part("U1", "top", (10.0, 20.0), 90.0, box=Box((1.0, -1.0), (5.0, 1.0)))
    assert part.center == pytest.approx((10.0, 23.0))
    assert Part("U1", "top", (10.0, 20.0), 90.0).center == (10.0, 20.0)


def test_mirroring_a_box_reverses_x_alone() -> None:
    assert Box((1, -2), (5, 3)).mirrored() == Box((-5, -2), (-1, 3))
    assert Box((0, 0), (4, 2)).shrunk(0.5) == Box((0.5, 0.5), (3.5, 1.5))
    assert Box((0, 0), (1, 2)).shrunk(5).size == pytest.approx((0.1, 0.2))


def test_a_small_drawing_is_no_body() -> None:
    pins, mark, outline = Box((-3, -2), (3, 2)), Box((-3, 1.5), (-2.5, 2.2)), Box((-2, -1.8), (2, 1.8))
    assert body_of(outline, pins) == outline
    assert body_of(mark, pins) == Box((-3, -2), (3, 2.2))
    assert (body_of(None, pins), body_of(mark, None)) == (pins, mark)


def test_points_without_an_area_have_no_box() -> None:
    assert box_around([]) is None
    assert box_around([(0, 0), (5, 0)]) is None
    assert box_around([(0, 0), (5, 1)]) == Box((0, 0), (5, 1))


@given(st.floats(-1e5, 1e5))
def test_angles_are_normalised(angle: float) -> None:
    found = normalised(angle)
    assert 0 <= found < 360
    assert rotated((1.0, 0.0), found) == pytest.approx(rotated((1.0, 0.0), angle), abs=1e-6)


def test_placements_follow_one_another_and_can_be_undone() -> None:
    inner, outer = Placement(True, 30.0, (1.0, 2.0)), Placement(True, 50.0, (4.0, -3.0))
    for point in ((1.0, 2.0), (-3.0, 0.5)):
        assert inner.within(outer).apply(point) == pytest.approx(outer.apply(inner.apply(point)))
        assert inner.undo(inner.apply(point)) == pytest.approx(point)
