from __future__ import annotations

import pytest

from vaoi_station.geometry.polygon import encloses, find_crossing_edges

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
