from __future__ import annotations

import math
import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.board_data.contours import CHORD_MM, arc_points, arc_through, area, circle_points, join

SQUARE = [(0.0, 0.0), (40.0, 0.0), (40.0, 30.0), (0.0, 30.0)]


def test_shuffled_and_reversed_pieces_close_one_contour() -> None:
    pieces = [[a, b] for a, b in zip(SQUARE, SQUARE[1:] + SQUARE[:1], strict=True)]
    pieces[1].reverse()
    random.Random(1).shuffle(pieces)
    closed, stray = join(pieces)
    assert (len(closed), stray) == (1, 0)
    assert abs(area(closed[0])) == pytest.approx(1200)
    assert set(closed[0]) == set(SQUARE)


def test_the_largest_contour_is_first_and_open_pieces_are_counted() -> None:
    closed, stray = join([circle_points((10, 10), 3), [*SQUARE, SQUARE[0]], [(50.0, 0.0), (60.0, 0.0)]])
    assert [round(abs(area(c))) for c in closed] == [1200, 28]
    assert stray == 1


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
