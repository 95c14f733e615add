from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from vaoi_station.board_data.contours import graph as g

CROSS = np.array([[(0, 0), (10, 0)], [(5, -5), (5, 5)], [(5, -5), (5, 5)]], dtype=float)
SQUARE = np.array([[(0, 0), (10, 0)], [(10, 0), (10, 10)], [(10, 10), (0, 10)], [(0, 10), (0, 0)]], dtype=float)


def test_lines_are_cut_where_they_cross_and_count_once() -> None:
    graph = g.graph_of(CROSS)
    assert len(graph.edges) == 4
    assert graph.loose == set(graph.names)
    assert not graph.faces


def test_a_bridge_leads_from_a_free_end_to_what_is_within_reach() -> None:
    near = np.array([[(0, 0), (4.99, 0)], [(5, -5), (5, 5)]], dtype=float)
    (bridge,) = g.bridges(g.graph_of(near), 0.02)
    assert sorted(map(tuple, bridge)) == [(4.99, 0), (5, 0)]
    assert not len(g.bridges(g.graph_of(near), 0.005))
    assert not len(g.bridges(g.graph_of(SQUARE), 0.02))


def test_each_free_end_has_one_gap_the_shortest_first() -> None:
    ends = np.array([[(0, 0), (4, 0)], [(4.3, 0), (8, 0)], [(4.1, 0), (4.1, 8)]], dtype=float)
    assert [sorted(map(tuple, gap)) for gap in g.gaps(g.graph_of(ends), 0.5)] == [[(4, 0), (4.1, 0)]]


def test_the_hull_of_faces_that_touch_is_one_and_a_thin_face_at_its_edge_is_none_of_it() -> None:
    beside = SQUARE + [10, 0]
    twice = np.array([[(0, 0), (0, -0.01)], [(0, -0.01), (10, -0.01)], [(10, -0.01), (10, 0)]])
    hull, *more = g.hulls(g.graph_of(np.concatenate([SQUARE, beside, twice])).faces)
    assert (hull.bounds, more) == ((0, 0, 20, 10), [])


@pytest.mark.parametrize(("end", "left"), [(10.0, 0), (12.0, 0), (6.0, 0), (8.0, 4)])
def test_a_stroke_divides_from_side_to_side_or_to_a_free_end(end: float, left: int) -> None:
    """At 8 the line meets a slot, which stays."""
    slot = SQUARE * 0.1 + [8, 4.5]
    lines = [SQUARE, [[(0, 5), (end, 5)]], slot] if end == 8 else [SQUARE, [[(0, 5), (end, 5)]]]
    graph = g.graph_of(np.concatenate([np.asarray(part, dtype=float) for part in lines]))
    inner = g.within(graph, g.hulls(graph.faces)[0])
    assert len(g.graph_of(inner).faces) == (left > 0)
    assert len(inner) >= left


def test_a_v_score_does_not_close_an_indentation() -> None:
    corners = [(0, 0), (20, 0), (20, 5), (18, 5), (18, 10), (0, 10), (0, 0)]
    edges = np.array(list(pairwise(corners)), dtype=float)
    graph = g.graph_of(np.concatenate([edges, [[(-3.0, 9.0), (23.0, 9.0)], [(19.0, -1.0), (19.0, 11.0)]]]))
    assert g.hulls(graph.faces)[0].area > 190
    (hull,) = g.hulls(g.without_strokes(graph, g.hulls(graph.faces)[0], 0.75).faces)
    assert hull.area == 190
