"""The planar graph of lines: its edges, and the faces that they enclose.

Coordinates are multiples of `GRID_MM`, so that lines that cross or touch share a node exactly. shapely is imported with
this module, so import it only where lines are there.
"""

from __future__ import annotations

import math
from collections import defaultdict
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
_MOST_BRIDGES = 8
"""Largest number of bridges from one node."""
_AT_ONCE, _MOST_PAIRS = 256, 20
"""Nodes whose neighbours are sought at once, and the largest mean number of neighbours of an edge."""
_MOST_STROKES, _MOST_TRIED = 20, 50_000
"""Strokes that are tried as V-scores across an indentation of the edge, and edges of all graphs without one."""
_MOST_BRANCHES = 12
"""Largest number of edges at a node through which a stroke goes."""
_MOST_LAYERS = 5
"""Times that thin faces are removed from the edge of the board: lines that are drawn more often are none."""
_BESIDE = JOIN_MM * STEPS
"""Largest distance of a node from a straight line on which it lies, in steps of the grid."""

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


def graph_of(edges: Edges) -> Graph:
    """Return the graph of lines that cross, touch, overlap or repeat each other."""
    # Thousands of short lines cross much faster when they are joined to long ones first.
    noded = shapely.get_parts(shapely.union_all(_merged(edges), grid_size=GRID_MM))
    faces, cuts, dangles, _ = shapely.polygonize_full(noded)
    loose = np.concatenate([_edges_of(cuts), _edges_of(dangles)])
    found = _edges_of(noded)
    return Graph(found, tuple(keys(found)), tuple(shapely.get_parts(faces)), frozenset(keys(loose)))


def rings_across(edges: Edges, graph: Graph, outline: Any, most: float) -> list[Any]:
    """Return contours of lines that close by themselves and lie partly beyond the largest such contour, the outline.

    Those larger than a share `most` of it are not among them.
    """
    boundary = set(boundary_keys([outline]))
    corners = {node for edge in boundary for node in edge}
    if not any((a in corners or b in corners) and (a, b) not in boundary for a, b in graph.names):
        return []
    rings = [shapely.Polygon(ring) for ring in shapely.get_parts(_merged(edges)) if shapely.is_ring(ring)]
    base = max(rings, key=lambda ring: ring.area, default=None)
    if base is None or base.area < outline.area / 2:
        return []
    crossing = shapely.STRtree(rings).query(base.exterior, predicate="intersects")
    small = [rings[n] for n in sorted(crossing) if rings[n].area <= most * base.area]
    return [ring for ring in small if not is_thin(ring - base) and not is_thin(ring & base)]


def without(edges: Edges, rings: Sequence[Any]) -> Edges:
    """Return the edges but for those of rings."""
    gone = set(boundary_keys(rings))
    return edges[[key not in gone for key in keys(edges)]]


def cut_off(outline: Any, notches: Sequence[Any]) -> Any:
    """Return the largest part of an outline that remains beside notches."""
    left = shapely.get_parts(outline - shapely.union_all(notches)) if notches else [outline]
    return by_size(shapely.Polygon(part.exterior) for part in left)[0]


def bridges(graph: Graph, reach_mm: float) -> Edges:
    """Return lines from the nodes of loose edges to the nearest edges within reach that they do not touch.

    None are returned if lines lie so close that they have thousands of such neighbours: that is no drawing of an edge.
    """
    if not graph.loose:
        return np.empty((0, 2, 2))
    nodes = _points({node for edge in graph.loose for node in edge})
    lines, points = shapely.linestrings(graph.edges), shapely.points(nodes)
    tree, found, count = shapely.STRtree(lines), [np.empty((0, 2, 2))], 0
    for part in np.array_split(points, -(-len(points) // _AT_ONCE)):
        near, line = tree.query(part, predicate="dwithin", distance=reach_mm + GRID_MM)
        count += len(near)
        if count > _MOST_PAIRS * (len(lines) + _AT_ONCE):
            return found[0]
        distance = shapely.distance(part[near], lines[line])
        order = np.lexsort((distance, near))
        near, line, distance = near[order], line[order], distance[order]
        apart = distance > GRID_MM / 2
        near, line = near[apart], line[apart]
        nearest = np.arange(len(near)) - np.searchsorted(near, near) < _MOST_BRIDGES
        found.append(_edges_of(shapely.shortest_line(part[near[nearest]], lines[line[nearest]])))
    return np.concatenate(found)


def gaps(graph: Graph, reach_mm: float) -> Edges:
    """Return lines between free ends within reach, the shortest first; each end has one."""
    ends = _points(node for node, count in _degrees(graph.loose).items() if count == 1)
    if len(ends) < 2:
        return np.empty((0, 2, 2))
    points = shapely.points(ends)
    first, second = shapely.STRtree(points).query(points, predicate="dwithin", distance=reach_mm)
    pairs = [
        (float(np.hypot(*(ends[a] - ends[b]))), int(a), int(b)) for a, b in zip(first, second, strict=True) if a < b
    ]
    used: set[int] = set()
    found = []
    for _, a, b in sorted(pairs):
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
        outside = set(boundary_keys(shapely.get_parts(shapely.coverage_union_all(left))))
        at_edge = [n for n in thin if _share(left[n], outside) >= _AT_EDGE]
        if not at_edge:
            break
        left = np.delete(left, at_edge)
    united = shapely.get_parts(shapely.coverage_union_all(left))
    found = [shapely.Polygon(polygon.exterior) for polygon in united]
    return by_size(polygon for polygon in found if not is_thin(polygon))


def _share(face: Any, edges: set[Edge]) -> float:
    """Return the share of the circumference of a face that consists of given edges."""
    own = _edges_of(face.exterior)
    lengths = np.hypot(*(own[:, 1] - own[:, 0]).T)
    return float(lengths[[key in edges for key in keys(own)]].sum() / lengths.sum())


def by_size(polygons: Iterable[Any]) -> list[Any]:
    """Return polygons, the largest first; of equal ones the one at the left, then at the bottom."""
    return sorted(polygons, key=lambda p: (-round(p.area, 3), *np.round(p.bounds, 2)))


def is_thin(polygon: Any) -> bool:
    """Return whether a polygon lies between lines that were meant to be one."""
    return bool(2 * polygon.area <= THIN_MM * polygon.length)  # of a long strip it is its width


def holes(graph: Graph) -> list[Any]:
    """Return what lies within faces, as polygons."""
    found = (shapely.Polygon(ring) for face in graph.faces for ring in face.interiors)
    return [polygon for polygon in found if not is_thin(polygon)]


def within(graph: Graph, polygon: Any) -> Edges:
    """Return the edges inside a polygon, without those on its boundary and those that divide it from side to side.

    A straight stroke divides it if it begins at the boundary and ends there or at no other edge: a V-score.
    """
    boundary = set(boundary_keys([polygon]))
    shapely.prepare(polygon)
    x, y = graph.edges.mean(axis=1).T
    inside = shapely.contains_xy(polygon, x, y)
    names = {name for name, is_inside in zip(graph.names, inside, strict=True) if is_inside} - boundary
    names -= _dividing(names, {node for edge in boundary for node in edge})
    return graph.edges[[name in names for name in graph.names]]


def without_strokes(graph: Graph, outline: Any, least: float) -> Graph:
    """Return the graph without V-scores that cross the board, and with it an indentation of its edge.

    These are straight strokes with two free ends that are in part on the outline, where it keeps a share `least` of its
    area without them. Sides of the board that cross beyond their corners are not: without one it is not closed.
    """
    boundary = set(boundary_keys([outline]))
    next_to, area, tried = _neighbours(graph.names), outline.area, 0
    free = [node for node, count in _degrees(graph.loose).items() if count == 1 and len(next_to[node]) == 1]
    for begin in sorted(free):
        (second,) = next_to[begin]
        stroke = _stroke(begin, second, next_to, set())
        edges = _along(stroke)
        if stroke[0] > stroke[-1] or len(next_to[stroke[-1]]) > 1 or not edges & boundary:
            continue
        tried += 1
        if tried > min(_MOST_STROKES, _MOST_TRIED // len(graph.edges)):
            break
        rest = graph_of(graph.edges[[name not in edges for name in graph.names]])
        left = hulls(rest.faces)
        if left and left[0].area >= least * area:
            graph = rest
    return graph


def boundary_keys(polygons: Iterable[Any]) -> list[Edge]:
    """Return the edges of outer contours."""
    return keys(_edges_of(shapely.get_exterior_ring(list(polygons))))


def keys(edges: Edges) -> list[Edge]:
    """Return every edge as its two nodes in their order."""
    ends = np.rint(edges * STEPS).astype(np.int64).reshape(-1, 4).tolist()
    return [((a, b), (c, d)) if (a, b) <= (c, d) else ((c, d), (a, b)) for a, b, c, d in ends]


def _dividing(edges: set[Edge], at_boundary: set[Node]) -> set[Edge]:
    """Return the edges of straight strokes from the boundary to the boundary or a free end."""
    begins = [(a, b) for edge in edges for a, b in (edge, edge[::-1]) if a in at_boundary]
    if not begins:
        return set()
    next_to = _neighbours(edges)
    found: set[Edge] = set()
    for begin, second in begins:
        stroke = _stroke(begin, second, next_to, at_boundary)
        if stroke[-1] in at_boundary or len(next_to[stroke[-1]]) == 1:
            found |= _along(stroke)
    return found


def _neighbours(edges: Iterable[Edge]) -> dict[Node, set[Node]]:
    found: defaultdict[Node, set[Node]] = defaultdict(set)
    for a, b in edges:
        found[a].add(b)
        found[b].add(a)
    return found


def _stroke(begin: Node, second: Node, next_to: dict[Node, set[Node]], until: set[Node]) -> list[Node]:
    """Return the nodes of a straight line from its first two on, to one of the nodes `until` or where it turns.

    Nodes may lie beside the line by the tolerance: where other lines end near it, short edges run aslant.
    """
    stroke = [begin, second]
    while stroke[-1] not in until and len(stroke) <= len(next_to) and len(next_to[stroke[-1]]) <= _MOST_BRANCHES:
        seen = set(stroke[-3:])
        further = [(_cosine(begin, stroke[-1], n), n) for n in next_to[stroke[-1]] if n not in seen]
        straight = [(cosine, n) for cosine, n in further if cosine > 0 and _beside(begin, stroke[-1], n) <= _BESIDE]
        if not straight:
            break
        stroke.append(max(straight)[1])
    return stroke


def _beside(a: Node, b: Node, c: Node) -> float:
    """Return the distance of b from the line through a and c."""
    ux, uy, vx, vy = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]
    return abs(ux * vy - uy * vx) / math.hypot(vx, vy)


def _along(stroke: Sequence[Node]) -> set[Edge]:
    return {(min(pair), max(pair)) for pair in pairwise(stroke)}


def _cosine(a: Node, b: Node, c: Node) -> float:
    """Return the cosine of the turn at b."""
    ux, uy, vx, vy = b[0] - a[0], b[1] - a[1], c[0] - b[0], c[1] - b[1]
    return (ux * vx + uy * vy) / (math.hypot(ux, uy) * math.hypot(vx, vy))


def _degrees(edges: Iterable[Edge]) -> dict[Node, int]:
    counts: defaultdict[Node, int] = defaultdict(int)
    for edge in edges:
        for node in edge:
            counts[node] += 1
    return counts


def is_amid_loose(polygon: Any, graph: Graph, most: float) -> bool:
    """Return whether loose edges lie around a polygon that is smaller than a share `most` of what they span."""
    if not graph.loose:
        return False
    lines = shapely.linestrings(np.array(sorted(graph.loose), dtype=np.float64) / STEPS)
    chains = shapely.get_parts(shapely.line_merge(shapely.multilinestrings(lines)))
    around = shapely.convex_hull(shapely.multilinestrings(chains[~shapely.intersects(polygon, chains)]))
    return bool(polygon.area < most * around.area and around.contains(polygon))


def _points(nodes: Iterable[Node]) -> NDArray[np.float64]:
    return np.array(sorted(nodes), dtype=np.float64).reshape(-1, 2) / STEPS


def _merged(edges: Edges) -> Any:
    """Return lines, each once, joined where two of them end."""
    # Equal lines are removed first: crossing them with each other takes long.
    ends = np.rint(edges * STEPS).astype(np.int64)
    swapped = (ends[:, 0, 0] > ends[:, 1, 0]) | ((ends[:, 0, 0] == ends[:, 1, 0]) & (ends[:, 0, 1] > ends[:, 1, 1]))
    ends[swapped] = ends[swapped, ::-1]
    once = np.unique(ends.reshape(-1, 4), axis=0).reshape(-1, 2, 2) / STEPS
    return shapely.line_merge(shapely.multilinestrings(shapely.linestrings(once)))


def _edges_of(lines: Any) -> Edges:
    """Return the straight edges of lines."""
    parts = shapely.get_parts(shapely.get_parts(lines))
    coordinates, line = shapely.get_coordinates(parts, return_index=True)
    same = line[1:] == line[:-1]
    return np.stack([coordinates[:-1][same], coordinates[1:][same]], axis=1)
