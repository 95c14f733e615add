"""The planar graph of lines: its edges, and the faces that they enclose.

Coordinates are multiples of `GRID_MM`, so that lines that cross or touch share a node exactly.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

STEPS = 10_000
"""Steps of coordinates in one mm, as in a board type."""
GRID_MM = 1 / STEPS
JOIN_MM = 0.02
"""Lines that are nearer than this touch; CAD systems round coordinates."""
THIN_MM = 2 * JOIN_MM
"""A face that is thinner lies between lines that were meant to be one: two lines, or two arcs, each drawn as chords."""
_AT_EDGE = 0.4
"""A thin face lies along the edge of the board if a larger share of its circumference does."""
_MOST_BRIDGES, _MOST_PAIRS, _AT_ONCE = 8, 20, 256
"""Bridges from one node, the mean number of neighbours of an edge, and nodes whose neighbours are sought at once."""
_MOST_STROKES, _MOST_TRIED = 20, 50_000
"""Strokes that are tried as V-scores across an indentation of the edge, and edges of all graphs without one."""
_MOST_BRANCHES = 12
"""Largest number of edges at a node through which a stroke goes."""
_MOST_LAYERS = 5
"""Times that thin faces are removed from the edge of the board: lines that are drawn more often are none."""

Edges = NDArray[np.float64]
"""Two ends of every edge: (n, 2, 2)."""
Node = tuple[int, int]
"""Coordinates in steps of `GRID_MM`."""
Edge = tuple[Node, Node]
"""Two nodes in their order."""


@dataclass(frozen=True)
class Graph:
    """Edges that meet at nodes only."""

    edges: Edges
    names: tuple[Edge, ...]
    """The nodes of every edge."""
    faces: tuple[Any, ...]
    """Polygons; holes are where other contours lie within."""
    loose: frozenset[Edge]
    """Edges that bound no face."""

    @staticmethod
    def of(edges: Edges) -> Graph:
        """Return the graph of lines that cross, touch, overlap or repeat each other."""
        # Thousands of short lines cross much faster when they are joined to long ones first.
        noded = shapely.get_parts(shapely.union_all(merged(edges), grid_size=GRID_MM))
        faces, cuts, dangles, _ = shapely.polygonize_full(noded)
        loose = np.concatenate([_edges_of(cuts), _edges_of(dangles)])
        found = _edges_of(noded)
        return Graph(found, tuple(keys(found)), tuple(shapely.get_parts(faces)), frozenset(keys(loose)))

    def with_edges(self, more: Edges) -> Graph:
        """Return the graph with further edges."""
        return Graph.of(np.concatenate([self.edges, more])) if len(more) else self

    def only(self, names: set[Edge]) -> Edges:
        """Return the edges of given names."""
        return self.edges[[name in names for name in self.names]]


def bridges(graph: Graph, reach_mm: float) -> Edges:
    """Return lines from the nodes of loose edges to the nearest edges within reach that they do not touch.

    None are returned if lines lie so close that they have thousands of such neighbours: that is no drawing of an edge.
    """
    found, count = [np.empty((0, 2, 2))], 0
    if not graph.loose:
        return found[0]
    lines, points = shapely.linestrings(graph.edges), shapely.points(_points({n for edge in graph.loose for n in edge}))
    tree = shapely.STRtree(lines)
    for part in np.array_split(points, -(-len(points) // _AT_ONCE)):
        near, line = tree.query(part, predicate="dwithin", distance=reach_mm + GRID_MM)
        count += len(near)
        if count > _MOST_PAIRS * (len(lines) + _AT_ONCE):
            return found[0]
        distance = shapely.distance(part[near], lines[line])
        order = np.lexsort((distance, near))
        order = order[distance[order] > GRID_MM / 2]
        near, line = near[order], line[order]
        nearest = np.arange(len(near)) - np.searchsorted(near, near) < _MOST_BRIDGES
        found.append(_edges_of(shapely.shortest_line(part[near[nearest]], lines[line[nearest]])))
    return np.concatenate(found)


def gaps(graph: Graph, reach_mm: float) -> Edges:
    """Return lines between free ends within reach, the shortest first; each end has one."""
    ends = _points(node for node, count in _degrees(graph.loose).items() if count == 1)
    found: list[list[NDArray[np.float64]]] = []
    if len(ends) > 1:
        points = shapely.points(ends)
        near = shapely.STRtree(points).query(points, predicate="dwithin", distance=reach_mm)
        pairs = zip(*near.tolist(), strict=True)
        used: set[int] = set()
        for _, a, b in sorted((float(np.hypot(*(ends[a] - ends[b]))), a, b) for a, b in pairs if a < b):
            if not {a, b} & used:
                used |= {a, b}
                found.append([ends[a], ends[b]])
    return np.array(found).reshape(-1, 2, 2)


def hulls(faces: Sequence[Any]) -> list[Any]:
    """Return the outer contours of faces that touch, as polygons without holes, the largest first."""
    left = np.array(faces, dtype=object)
    for _ in range(_MOST_LAYERS):
        # A line that is drawn twice makes a thin face, which is no part of the board where it lies along its edge.
        thin = np.flatnonzero(2 * shapely.area(left) <= THIN_MM * shapely.length(left))
        if not len(thin):
            break
        outside = boundary([*shapely.get_parts(shapely.coverage_union_all(left))])
        at_edge = [n for n in thin if _share(left[n], outside) >= _AT_EDGE]
        if not at_edge:
            break
        left = np.delete(left, at_edge)
    united = shapely.get_parts(shapely.coverage_union_all(left))
    found = [shapely.Polygon(polygon.exterior) for polygon in united]
    return by_size(polygon for polygon in found if not is_thin(polygon))


def _share(face: Any, edges: set[Edge]) -> float:
    own = _edges_of(face.exterior)
    lengths = np.hypot(*(own[:, 1] - own[:, 0]).T)
    return float(lengths[[key in edges for key in keys(own)]].sum() / lengths.sum())


def by_size(polygons: Iterable[Any]) -> list[Any]:
    """Return polygons, the largest first; of equal ones the one at the left, then at the bottom."""
    return sorted(polygons, key=lambda p: (-round(p.area, 3), *np.round(p.bounds, 2)))


def is_thin(polygon: Any) -> bool:
    """Return whether a polygon lies between lines that were meant to be one."""
    return bool(2 * polygon.area <= THIN_MM * polygon.length)  # of a long strip it is its width


def rings_across(edges: Edges, graph: Graph, outline: Any, most: float) -> list[Any]:
    """Return contours of lines that close by themselves and lie partly beyond the largest such contour, the outline.

    Those larger than a share `most` of it are not among them.
    """
    at_edge = boundary([outline])
    corners = {node for edge in at_edge for node in edge}
    if not any((a in corners or b in corners) and (a, b) not in at_edge for a, b in graph.names):
        return []
    rings = [shapely.Polygon(ring) for ring in shapely.get_parts(merged(edges)) if shapely.is_ring(ring)]
    base = max(rings, key=lambda ring: ring.area, default=None)
    if base is None or base.area < outline.area / 2:
        return []
    crossing = shapely.STRtree(rings).query(base.exterior, predicate="intersects")
    small = [rings[n] for n in sorted(crossing) if rings[n].area <= most * base.area]
    return [ring for ring in small if not is_thin(ring - base) and not is_thin(ring & base)]


def within(graph: Graph, polygon: Any) -> Edges:
    """Return the edges inside a polygon, without those on its boundary and those that divide it from side to side.

    A straight stroke divides it if it begins at the boundary and ends there or at no other edge: a V-score.
    """
    at_edge = boundary([polygon])
    corners = {node for edge in at_edge for node in edge}
    shapely.prepare(polygon)
    inside = shapely.contains_xy(polygon, *graph.edges.mean(axis=1).T)
    names = {name for name, is_inside in zip(graph.names, inside, strict=True) if is_inside} - at_edge
    next_to, dividing = _neighbours(names), set[Edge]()
    for begin, second in [(a, b) for edge in names for a, b in (edge, edge[::-1]) if a in corners]:
        stroke = _stroke(begin, second, next_to, corners)
        if stroke[-1] in corners or len(next_to[stroke[-1]]) == 1:
            dividing |= _along(stroke)
    return graph.only(names - dividing)


def without_strokes(graph: Graph, outline: Any, least: float) -> Graph:
    """Return the graph without V-scores that cross the board, and with it an indentation of its edge.

    These are straight strokes with two free ends that are in part on the outline, where it keeps a share `least` of its
    area without them. Sides of the board that cross beyond their corners are not: without one it is not closed.
    """
    at_edge, next_to, tried = boundary([outline]), _neighbours(graph.names), 0
    free = [node for node, count in _degrees(graph.loose).items() if count == 1 and len(next_to[node]) == 1]
    for begin in sorted(free):
        stroke = _stroke(begin, min(next_to[begin]), next_to, set())
        edges = _along(stroke)
        if stroke[0] > stroke[-1] or len(next_to[stroke[-1]]) > 1 or not edges & at_edge:
            continue
        tried += 1
        if tried > min(_MOST_STROKES, _MOST_TRIED // len(graph.edges)):
            break
        rest = Graph.of(graph.only(set(graph.names) - edges))
        left = hulls(rest.faces)
        if left and left[0].area >= least * outline.area:
            graph = rest
    return graph


def is_amid_loose(polygon: Any, graph: Graph, most: float) -> bool:
    """Return whether loose edges lie around a polygon that is smaller than a share `most` of what they span."""
    if not graph.loose:
        return False
    lines = shapely.linestrings(np.array(sorted(graph.loose), dtype=np.float64) / STEPS)
    chains = shapely.get_parts(shapely.line_merge(shapely.multilinestrings(lines)))
    around = shapely.convex_hull(shapely.multilinestrings(chains[~shapely.intersects(polygon, chains)]))
    return bool(polygon.area < most * around.area and around.contains(polygon))


def boundary(polygons: Sequence[Any]) -> set[Edge]:
    """Return the edges of outer contours."""
    return set(keys(_edges_of(shapely.get_exterior_ring(polygons))))


def keys(edges: Edges) -> list[Edge]:
    """Return every edge as its two nodes in their order."""
    ends = np.rint(edges * STEPS).astype(np.int64).reshape(-1, 4).tolist()
    return [((a, b), (c, d)) if (a, b) <= (c, d) else ((c, d), (a, b)) for a, b, c, d in ends]


def _neighbours(edges: Iterable[Edge]) -> dict[Node, set[Node]]:
    found: defaultdict[Node, set[Node]] = defaultdict(set)
    for a, b in edges:
        found[a].add(b)
        found[b].add(a)
    return found


def _degrees(edges: Iterable[Edge]) -> Counter[Node]:
    return Counter(node for edge in edges for node in edge)


def _stroke(begin: Node, second: Node, next_to: dict[Node, set[Node]], until: set[Node]) -> list[Node]:
    """Return the nodes of a straight line from its first two on, to one of the nodes `until` or where it turns.

    Nodes may lie beside the line by the tolerance: where other lines end near it, short edges run aslant.
    """
    stroke = [begin, second]
    while stroke[-1] not in until and len(stroke) <= len(next_to) and len(next_to[stroke[-1]]) <= _MOST_BRANCHES:
        (x0, y0), (x1, y1) = begin, stroke[-1]
        ux, uy, straight = x1 - x0, y1 - y0, []
        for x, y in next_to[stroke[-1]] - set(stroke[-3:]):
            vx, vy, wx, wy = x - x1, y - y1, x - x0, y - y0
            forward = ux * vx + uy * vy
            if forward > 0 and abs(ux * wy - uy * wx) / math.hypot(wx, wy) <= JOIN_MM * STEPS:
                straight.append((forward / (math.hypot(ux, uy) * math.hypot(vx, vy)), (x, y)))
        if not straight:
            break
        stroke.append(max(straight)[1])
    return stroke


def _along(stroke: Sequence[Node]) -> set[Edge]:
    return {(min(pair), max(pair)) for pair in pairwise(stroke)}


def _points(nodes: Iterable[Node]) -> NDArray[np.float64]:
    return np.array(sorted(nodes), dtype=np.float64).reshape(-1, 2) / STEPS


def merged(edges: Edges) -> Any:
    """Return lines, each once, joined where two of them end."""
    # Equal lines are removed first: crossing them with each other takes long.
    once = np.array(sorted(set(keys(edges))), dtype=np.float64).reshape(-1, 2, 2) / STEPS
    return shapely.line_merge(shapely.multilinestrings(shapely.linestrings(once)))


def _edges_of(lines: Any) -> Edges:
    parts = shapely.get_parts(shapely.get_parts(lines))
    coordinates, line = shapely.get_coordinates(parts, return_index=True)
    same = line[1:] == line[:-1]
    return np.stack([coordinates[:-1][same], coordinates[1:][same]], axis=1)
