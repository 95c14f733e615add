from __future__ import annotations

import math
import random
import time
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.board_data.contours import CHORD_MM, JOIN_MM, arc_points, arc_through, area, circle_points, join

SQUARE = [(0.0, 0.0), (40.0, 0.0), (40.0, 30.0), (0.0, 30.0)]


def test_shuffled_and_reversed_pieces_close_one_contour() -> None:
    pieces = [[a, b] for a, b in zip(SQUARE, SQUARE[1:] + SQUARE[:1], strict=True)]
    pieces[1].reverse()
    random.Random(1).shuffle(pieces)
    closed, stray = join(pieces)
    assert (len(closed), stray) == (1, 0)
    assert abs(area(closed[0])) == pytest.approx(1200)
    assert set(closed[0]) == set(SQUARE)


def test_the_time_for_an_outline_grows_with_its_length_only() -> None:
    """Of 40,000 lines each end was compared with each: minutes."""
    count = 40_000
    corners = [(200 * math.cos(a), 200 * math.sin(a)) for a in (2 * math.pi * k / count for k in range(count))]
    pieces = [[a, b] for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    star = [[(5000.0, 0.0), (5000 + (9 + k) * math.cos(k), (9 + k) * math.sin(k))] for k in range(2000)]
    random.Random(1).shuffle(pieces)
    begun_s = time.process_time()
    closed, stray = join(pieces + star)
    assert time.process_time() - begun_s < 5
    assert ([len(contour) for contour in closed], stray) == ([count], len(star))


def test_of_two_ends_the_nearer_one_is_joined() -> None:
    square = [[a, b] for a, b in zip(SQUARE, SQUARE[1:] + SQUARE[:1], strict=True)]
    off = [[(x + 0.6 * JOIN_MM, y) for x, y in piece] for piece in square]
    closed, stray = join(off + square)
    assert ([round(abs(area(c)), 6) for c in closed], stray) == ([1200, 1200], 0)
    assert all(len({round(x % 1, 6) for x, _ in contour}) == 1 for contour in closed)


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
