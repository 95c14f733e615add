from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.geometry.polygon import encloses, find_crossing_edges, pixels_inside

BOX = [(0.0, 10.0), (20.0, 0.0)]
ELL = [(0.0, 0.0), (20.0, 0.0), (20.0, 5.0), (5.0, 5.0), (5.0, 20.0), (0.0, 20.0)]


@pytest.mark.parametrize(
    ("outline", "point", "inside"),
    [
        (BOX, (10, 5), True),
        (BOX, (0, 0), True),
        (BOX, (20, 10), True),
        (BOX, (20.001, 5), False),
        (BOX, (10, -0.001), False),
        (ELL, (2, 18), True),
        (ELL, (18, 2), True),
        (ELL, (12, 12), False),
        (ELL, (5, 12), True),
        (ELL, (5.001, 12), False),
        (ELL, (5, 5), True),
        (ELL, (-1, 5), False),
        (ELL, (25, 0), False),
        (ELL[::-1], (2, 18), True),
        (ELL[::-1], (12, 12), False),
    ],
)
def test_encloses(outline: list[tuple[float, float]], point: tuple[float, float], inside: bool) -> None:
    assert encloses(outline, point) is inside


BOW_TIE = [(0.0, 0.0), (10.0, 10.0), (10.0, 0.0), (0.0, 10.0)]


@pytest.mark.parametrize(
    ("outline", "edges"),
    [
        (BOX, None),
        (ELL, None),
        (ELL[::-1], None),
        (BOX + [(5.0, 5.0)], None),
        (BOW_TIE, (0, 2)),
        ([(0.0, 0.0), (10.0, 0.0), (10.0, 5.0), (4.0, 0.0), (0.0, 5.0)], (0, 2)),
        ([(0.0, 0.0), (10.0, 0.0), (10.0, 5.0), (20.0, 5.0), (20.0, 0.0), (30.0, 0.0), (30.0, 9.0), (0.0, 9.0)], None),
    ],
)
def test_edges_that_cross_or_touch(outline: list[tuple[float, float]], edges: tuple[int, int] | None) -> None:
    assert find_crossing_edges(outline) == edges


def test_pixels_inside_a_convex_polygon() -> None:
    corners = np.array([(0.5, 0.0), (3.0, 0.0), (3.0, 2.0), (0.5, 2.0)])
    expected = np.zeros((4, 5), bool)
    expected[:3, 1:4] = True
    for turned in (corners, corners[::-1]):
        np.testing.assert_array_equal(pixels_inside(turned, 5, 4), expected)
    diamond = np.array([(2.0, -0.1), (4.1, 2.0), (2.0, 4.1), (-0.1, 2.0)])
    assert pixels_inside(diamond, 5, 5).sum(1).tolist() == [1, 3, 5, 3, 1]
