from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.board_data.contours import CHORD_MM, arc_points, arc_through, area, circle_points


@given(st.floats(0.05, 200), st.floats(0, 6.2), st.floats(0.1, 6.1), st.booleans())
def test_arcs_stay_near_their_circle(radius: float, first: float, sweep: float, clockwise: bool) -> None:
    last = first - sweep if clockwise else first + sweep
    start, end = ((radius * math.cos(a), radius * math.sin(a)) for a in (first, last))
    points = arc_points(start, end, (0.0, 0.0), clockwise)
    assert (points[0], points[-1]) == (start, end)
    for a, b in pairwise(points):
        middle = math.hypot((a[0] + b[0]) / 2, (a[1] + b[1]) / 2)
        assert radius - middle <= max(1.5 * CHORD_MM, 0.35 * radius if radius < 2 * CHORD_MM else 0)


def test_an_arc_through_three_points_passes_the_middle() -> None:
    points = arc_through((1, 0), (0, 1), (-1, 0))
    assert min(math.dist(p, (0, 1)) for p in points) < 0.15
    assert all(math.hypot(*p) == pytest.approx(1, abs=1e-9) for p in points)
    assert arc_through((0, 0), (1, 0), (2, 0)) == [(0, 0), (1, 0), (2, 0)]


def test_a_circle_has_its_extreme_points_and_its_area() -> None:
    points = circle_points((10, 5), 2)
    assert {(round(x, 9), round(y, 9)) for x, y in points} >= {(12, 5), (10, 7), (8, 5), (10, 3)}
    assert area(points[:-1]) == pytest.approx(math.pi * 4, rel=0.03)
    assert area(points[:0:-1]) < 0
