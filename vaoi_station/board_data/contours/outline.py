"""The outline of a board and its cut-outs, from the lines and arcs of a drawing.

The lines make a planar graph, and contours are boundaries of its faces: lines that divide a face, end freely, repeat
others or pass a corner change none. Lines in any order and direction, split anywhere, give the same contours. shapely
is loaded with this module.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from vaoi_station.board_data.contours import Contours
from vaoi_station.board_data.contours import graph as g
from vaoi_station.board_data.contours.graph import GRID_MM, JOIN_MM, STEPS, THIN_MM, Edges, Graph
from vaoi_station.board_data.design import XY, Contour, noted, places
from vaoi_station.board_data.source_text import LARGEST_NUMBER
from vaoi_station.model.reason import Note

SMALL_GAP_MM = 0.1
"""Free ends that are nearer are joined, and it is said."""
MOST_GAP_MM = 1.5
"""Free ends that are nearer are joined where there is no outline without."""
_NOTCH = 0.25
"""Largest share of the outline that a closed contour across it cuts off; a larger one is part of the board."""
_WITHOUT_STROKE = 0.75
"""Share of its area that the outline keeps at least without a V-score across an indentation of its edge."""
_ENCLOSED = 0.25
"""Share of what free lines span below which a contour amid them is not the outline: they are, but not closed."""
_REASONS = {
    "open": "close no contour",
    "dividing": "divide a board or cut-out",
    "repeating": "repeat others",
    "short": f"within {JOIN_MM:g} mm",
    "beyond": "in part, beyond their contour",
}
"""Why a line is no part of a contour."""


def contours_of(drawn: Sequence[Sequence[XY]], source: str) -> Contours:
    """Return the outline and the cut-outs that lines, one at least, enclose; see `find_contours`.

    The outline is the outer contour of all faces that touch, of the largest such group. Closed contours within it are
    cut-outs; a straight line from edge to edge of the board (a V-score) makes none.
    """
    drawing = Drawing(drawn)
    graph, joined = _closed(drawing.edges)
    outer = g.hulls(graph.faces)
    notches = g.rings_across(drawing.edges, graph, outer[0], _NOTCH) if outer else []
    if notches:
        gone = g.boundary(notches)
        graph, joined = _closed(drawing.edges[[key not in gone for key in g.keys(drawing.edges)]])
        outer = g.hulls(graph.faces)
    notes = []
    if not outer or g.is_amid_loose(outer[0], graph, _ENCLOSED):
        if outer:
            text = "lines of {source} around all closed contours are not closed themselves: there is no outline."
            notes.append(noted("outline-open", text, source=source))
        return Contours(notes=(*notes, *note_on_unused(drawing, graph, outer, source)))
    board = g.without_strokes(graph, outer[0], _WITHOUT_STROKE)
    outline, *beside = outer = g.hulls(board.faces)
    inner = Graph.of(g.within(board, outline))
    cut_outs = g.hulls(inner.faces)
    rings = (shapely.Polygon(ring) for face in inner.faces for ring in face.interiors)
    islands = [polygon for polygon in rings if not g.is_thin(polygon)]
    closed = g.boundary([*outer, *cut_outs])
    gaps = [gap for gap, key in zip(joined, g.keys(joined), strict=True) if key in closed]
    if gaps:
        size, at = f"{max(np.hypot(*(a - b)) for a, b in gaps):.3g}", places(gap.mean(axis=0) for gap in gaps)
        text = "contours have gaps of up to {size_mm} mm; they were closed: at {at}."
        notes.append(noted("outline-gaps-closed", text, size_mm=size, at=at))
    if notches:
        text = "{count} contours cross the outline; what they enclose was cut off it: from {at} on."
        notes.append(noted("notches-cut-off", text, count=len(notches), at=places(n.bounds[:2] for n in notches)))
    if islands:
        text = "{count} contours lie within a cut-out; they were left out: from {at} on."
        notes.append(noted("islands-left-out", text, count=len(islands), at=places(i.bounds[:2] for i in islands)))
    notes += note_on_unused(drawing, graph, [*outer, *cut_outs, *islands, *notches], source)
    if notches:
        left = shapely.get_parts(outline - shapely.union_all(notches))
        outline = g.by_size(shapely.Polygon(part.exterior) for part in left)[0]
    others = g.by_size([*cut_outs, *beside])
    return Contours(_corners(outline), tuple(map(_corners, others)), tuple(map(_corners, islands)), tuple(notes))


def _closed(edges: Edges) -> tuple[Graph, Edges]:
    """Return the graph with gaps up to the tolerance closed, and the larger gaps that had to be closed."""
    graph = Graph.of(edges)
    graph = graph.with_edges(g.bridges(graph, JOIN_MM))
    joined = g.gaps(graph, SMALL_GAP_MM)
    graph = graph.with_edges(joined)
    wide = g.gaps(graph, MOST_GAP_MM)
    if len(wide):
        wider = graph.with_edges(wide)
        found, without = (sum(hull.area for hull in g.hulls(of.faces)[:1]) for of in (wider, graph))
        if found > 2 * without:
            return wider, np.concatenate([joined, wide])
    return graph, joined


def _corners(polygon: Any) -> Contour:
    """Return the corners of a polygon from its leftmost one on, without those where lines meet straight."""
    ring = polygon.normalize().simplify(JOIN_MM).exterior
    return tuple((float(x), float(y)) for x, y in ring.coords[:0:-1])


class Drawing:
    """Lines and arcs, and the straight edges that they consist of."""

    def __init__(self, pieces: Sequence[Sequence[XY]]) -> None:
        """Take the points of every piece, mm; raise ValueError for a coordinate that is not finite, or too large."""
        points = np.array([point for piece in pieces for point in piece], dtype=np.float64)
        if not (np.abs(points) <= LARGEST_NUMBER).all():  # false of what is not a number, too
            raise ValueError("coordinates")
        points = np.round(points * STEPS) / STEPS
        of = np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])
        same = of[1:] == of[:-1]
        edges, piece = np.stack([points[:-1][same], points[1:][same]], axis=1), of[1:][same]
        has_length = (edges[:, 0] != edges[:, 1]).any(axis=1)
        self.first = [piece[0] for piece in pieces]
        """Where every piece begins."""
        self.edges, self.piece = edges[has_length], piece[has_length]
        lengths = np.hypot(*(self.edges[:, 1] - self.edges[:, 0]).T)
        self.length = np.bincount(self.piece, lengths, minlength=len(pieces))
        """Length of every piece, mm."""


def note_on_unused(drawing: Drawing, graph: Graph, contours: Sequence[Any], source: str) -> list[Note]:
    """Return a note on the pieces that are no part of the contours, and why; none if all are."""
    found = _unused(drawing, graph, contours)
    if not found:
        return []
    values: dict[str, object] = {"count": sum(map(len, found.values())), "source": source}
    words = []
    for reason, words_of in _REASONS.items():
        at = places(drawing.first[piece] for piece in found[reason])
        values |= {reason: len(found[reason]), f"{reason}_at": at}
        if found[reason]:
            words.append(f"{len(found[reason])} {words_of} at {at}")
    return [Note("lines-left-out", f"lines of {source} were left out: {'; '.join(words)}.", **values)]


def _unused(drawing: Drawing, graph: Graph, contours: Sequence[Any]) -> defaultdict[str, list[int]]:
    """Return reason → numbers of the pieces."""
    boundary = g.boundary(contours)
    used = np.array([name in boundary for name in graph.names], dtype=bool)
    near = _near(graph, used)
    edge, piece = _pieces_on(graph, drawing)
    # Of pieces that repeat each other the longest counts; the order of the file decides between equal ones only.
    rank = np.argsort(np.lexsort((np.arange(len(drawing.length)), -drawing.length)))
    order = np.lexsort((rank[piece], edge))
    _, first = np.unique(edge[order], return_index=True)
    keeps = order[first]
    in_use = set(piece[keeps][used[edge[keeps]]].tolist())
    touched = set(piece[(~used & ~near)[edge]].tolist()) | (set(range(len(drawing.length))) - in_use)
    own: defaultdict[int, list[int]] = defaultdict(list)
    for e, p in zip(edge.tolist(), piece.tolist(), strict=True):
        own[p].append(e)
    found: defaultdict[str, list[int]] = defaultdict(list)
    for p in sorted(touched):
        if p in in_use:
            reason = "beyond"
        elif drawing.length[p] <= JOIN_MM:
            reason = "short"
        elif not own[p]:  # of a notch: it was cut off
            continue
        elif all(used[e] or near[e] for e in own[p]):
            reason = "repeating"
        else:
            reason = "open" if all(graph.names[e] in graph.loose for e in own[p]) else "dividing"
        found[reason].append(p)
    return found


def _pieces_on(graph: Graph, drawing: Drawing) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return pairs of an edge of the graph and a piece that lies on it."""
    lines = shapely.linestrings(drawing.edges)
    middle = shapely.points(graph.edges.mean(axis=1))
    edge, line = shapely.STRtree(lines).query(middle, predicate="dwithin", distance=GRID_MM)
    for end in (0, 1):
        on = shapely.distance(shapely.points(graph.edges[edge, end]), lines[line]) <= GRID_MM
        edge, line = edge[on], line[on]
    return edge, drawing.piece[line]


def _near(graph: Graph, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which edges lie along a contour without being part of it: all of each within the tolerance."""
    found = ~used
    if used.any() and found.any():
        rest = np.flatnonzero(found)
        tree = shapely.STRtree(shapely.linestrings(graph.edges[used]))
        for points in (graph.edges[rest, 0], graph.edges[rest, 1], graph.edges[rest].mean(axis=1)):
            hit, _ = tree.query(shapely.points(points), predicate="dwithin", distance=THIN_MM)
            found[rest] &= np.isin(np.arange(len(rest)), hit)
        return found
    return np.zeros(len(used), dtype=bool)
