"""Which lines of a drawing are no part of its contours, and why."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from vaoi_station.board_data.contours.graph import GRID_MM, JOIN_MM, STEPS, THIN_MM, Graph, boundary_keys
from vaoi_station.board_data.contours.places import places
from vaoi_station.board_data.design import XY
from vaoi_station.board_data.source_text import LARGEST_NUMBER
from vaoi_station.model.reason import Note

_REASONS = {
    "open": "close no contour",
    "dividing": "divide a board or cut-out",
    "repeating": "repeat others",
    "short": f"within {JOIN_MM:g} mm",
    "beyond": "in part, beyond their contour",
}


class Drawing:
    """Lines and arcs, and the straight edges that they consist of."""

    def __init__(self, pieces: Sequence[Sequence[XY]]) -> None:
        """Take the points of every piece, mm.

        Raises:
            ValueError: a coordinate is not finite, or too large.
        """
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
    """Return a note on the pieces that are no part of the contours; none if all are."""
    found = _unused(drawing, graph, contours)
    if not found:
        return []
    count = sum(map(len, found.values()))
    values: dict[str, object] = {"count": count, "source": source}
    words = []
    for reason, words_of in _REASONS.items():
        at = places(drawing.first[piece] for piece in found[reason])
        values |= {reason: len(found[reason]), f"{reason}_at": at}
        if found[reason]:
            words.append(f"{len(found[reason])} {words_of} at {at}")
    return [Note("lines-left-out", f"lines of {source} were left out: {'; '.join(words)}.", **values)]


def _unused(drawing: Drawing, graph: Graph, contours: Sequence[Any]) -> defaultdict[str, list[int]]:
    """Return reason → numbers of the pieces."""
    boundary = set(boundary_keys(contours))
    used = np.array([name in boundary for name in graph.names], dtype=bool)
    loose = np.array([name in graph.loose for name in graph.names], dtype=bool)
    edge, piece = _pieces_on(graph, drawing)
    # Of pieces that repeat each other the longest counts; the order of the file decides between equal ones only.
    rank = np.argsort(np.lexsort((np.arange(len(drawing.length)), -drawing.length)))
    order = np.lexsort((rank[piece], edge))
    _, first = np.unique(edge[order], return_index=True)
    keeps = order[first]
    in_use = set(piece[keeps][used[edge[keeps]]].tolist())
    near = _near(graph, used)
    found: defaultdict[str, list[int]] = defaultdict(list)
    own: defaultdict[int, list[int]] = defaultdict(list)
    beyond = ~used & ~near
    touched = set(piece[beyond[edge]].tolist()) | (set(range(len(drawing.length))) - in_use)
    for e, p in zip(edge.tolist(), piece.tolist(), strict=True):
        if p in touched:
            own[p].append(e)
    for p in sorted(touched):
        edges = own[p]
        if p in in_use:
            found["beyond"].append(p)
        elif drawing.length[p] <= JOIN_MM:
            found["short"].append(p)
        elif not edges:  # of a notch: it was cut off
            continue
        elif all(used[e] or near[e] for e in edges):
            found["repeating"].append(p)
        elif all(loose[e] for e in edges):
            found["open"].append(p)
        else:
            found["dividing"].append(p)
    return found


def _pieces_on(graph: Graph, drawing: Drawing) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return pairs of an edge of the graph and a piece that lies on it."""
    if not len(graph.edges):
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    lines = shapely.linestrings(drawing.edges)
    middle = shapely.points(graph.edges.mean(axis=1))
    edge, line = shapely.STRtree(lines).query(middle, predicate="dwithin", distance=GRID_MM)
    for end in (0, 1):
        on = shapely.distance(shapely.points(graph.edges[edge, end]), lines[line]) <= GRID_MM
        edge, line = edge[on], line[on]
    return edge, drawing.piece[line]


def _near(graph: Graph, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which edges lie along a contour without being part of it: all of each within the tolerance."""
    found = np.zeros(len(used), dtype=bool)
    rest = np.flatnonzero(~used)
    if not used.any() or not len(rest):
        return found
    tree = shapely.STRtree(shapely.linestrings(graph.edges[used]))
    near = np.ones(len(rest), dtype=bool)
    for points in (graph.edges[rest, 0], graph.edges[rest, 1], graph.edges[rest].mean(axis=1)):
        hit, _ = tree.query(shapely.points(points), predicate="dwithin", distance=THIN_MM)
        near &= np.isin(np.arange(len(rest)), hit)
    found[rest] = near
    return found
