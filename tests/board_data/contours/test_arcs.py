from __future__ import annotations

import math
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.board_data.contours import CHORD_MM, arc_points


@given(st.floats(0.05, 200), st.floats(0, 6.2), st.floats(0.1, 6.1), st.booleans())
def test_arcs_stay_near_their_circle(radius: float, first: float, sweep: float, clockwise: bool) -> None:
    last = first - sweep if clockwise else first + sweep
    start, end = ((radius * math.cos(a), radius * math.sin(a)) for a in (first, last))
    points = arc_points(start, end, (0.0, 0.0), clockwise)
    assert (points[0], points[-1]) == (start, end)
    for a, b in pairwise(points):
        middle = math.hypot((a[0] + b[0]) / 2, (a[1] + b[1]) / 2)
        assert radius - middle <= max(1.5 * CHORD_MM, 0.35 * radius if radius < 2 * CHORD_MM else 0)
