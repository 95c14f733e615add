"""The outline of a board and its cut-outs, from the lines and arcs of a drawing.

The lines make a planar graph, and contours are boundaries of its faces: lines that divide a face, end freely, repeat
others or pass a corner change none. Lines in any order and direction, split anywhere, give the same contours.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vaoi_station.board_data.contours.places import places
from vaoi_station.board_data.design import XY
from vaoi_station.model.reason import Note

if TYPE_CHECKING:
    from vaoi_station.board_data.contours.graph import Edges, Graph

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


@dataclass(frozen=True)
class Contours:
    """What the lines of a drawing enclose; contours run counter-clockwise, without a repeated corner."""

    outline: tuple[XY, ...] = ()
    """The largest outer contour; empty if the lines around all others are not closed."""
    others: tuple[tuple[XY, ...], ...] = ()
    """The cut-outs, and contours beside the outline; the largest first."""
    islands: tuple[tuple[XY, ...], ...] = ()
    """Contours within cut-outs."""
    notes: tuple[Note, ...] = ()


def find_contours(pieces: Iterable[Sequence[XY]], source: str) -> Contours:
    """Return the outline and the cut-outs that lines enclose, and notes on lines that were not used.

    The outline is the outer contour of all faces that touch, of the largest such group. Closed contours within it are
    cut-outs; a straight line from edge to edge of the board (a V-score) makes none.

    Args:
        pieces: lines and arcs as points, mm.
        source: what the drawing is called, for the notes.

    Raises:
        ValueError: a coordinate is not finite, or too large.
    """
    drawn = [piece for piece in pieces if len(piece)]
    if not drawn:
        return Contours()
    # shapely is loaded when there is a drawing: the command line must start fast.
    from vaoi_station.board_data.contours import graph as g
    from vaoi_station.board_data.contours.unused import Drawing, note_on_unused

    drawing = Drawing(drawn)
    graph, joined = _closed(drawing.edges)
    outer = g.hulls(graph.faces)
    notches = g.rings_across(drawing.edges, graph, outer[0], _NOTCH) if outer else []
    if notches:
        graph, joined = _closed(g.without(drawing.edges, notches))
        outer = g.hulls(graph.faces)
    notes = []
    if not outer or g.is_amid_loose(outer[0], graph, _ENCLOSED):
        if outer:
            sentence = f"lines of {source} around all closed contours are not closed themselves: there is no outline."
            notes.append(Note("outline-open", sentence, source=source))
        return Contours(notes=(*notes, *note_on_unused(drawing, graph, outer, source)))
    board = g.without_strokes(graph, outer[0], _WITHOUT_STROKE)
    outline, *beside = outer = g.hulls(board.faces)
    inner = g.graph_of(g.within(board, outline))
    cut_outs, islands = g.hulls(inner.faces), g.holes(inner)
    closed = set(g.boundary_keys([*outer, *cut_outs]))
    gaps = [gap for gap, key in zip(joined, g.keys(joined), strict=True) if key in closed]
    if gaps:
        size, at = f"{max(np.hypot(*(a - b)) for a, b in gaps):.3g}", places(gap.mean(axis=0) for gap in gaps)
        sentence = f"contours have gaps of up to {size} mm; they were closed: at {at}."
        notes.append(Note("outline-gaps-closed", sentence, size_mm=size, at=at))
    if notches:
        at = places(notch.bounds[:2] for notch in notches)
        sentence = f"{len(notches)} contours cross the outline; what they enclose was cut off it: from {at} on."
        notes.append(Note("notches-cut-off", sentence, count=len(notches), at=at))
    if islands:
        at = places(island.bounds[:2] for island in islands)
        sentence = f"{len(islands)} contours lie within a cut-out; they were left out: from {at} on."
        notes.append(Note("islands-left-out", sentence, count=len(islands), at=at))
    notes += note_on_unused(drawing, graph, [*outer, *cut_outs, *islands, *notches], source)
    others = g.by_size([*cut_outs, *beside])
    return Contours(
        outline=_corners(g.cut_off(outline, notches)),
        others=tuple(map(_corners, others)),
        islands=tuple(map(_corners, islands)),
        notes=tuple(notes),
    )


def _closed(edges: Edges) -> tuple[Graph, Edges]:
    """Return the graph with gaps up to the tolerance closed, and the larger gaps that had to be closed."""
    from vaoi_station.board_data.contours import graph as g

    graph = g.graph_of(edges)
    if len(bridges := g.bridges(graph, g.JOIN_MM)):
        graph = g.graph_of(np.concatenate([graph.edges, bridges]))
    joined = g.gaps(graph, SMALL_GAP_MM)
    if len(joined):
        graph = g.graph_of(np.concatenate([graph.edges, joined]))
    wide = g.gaps(graph, MOST_GAP_MM)
    if len(wide):
        wider = g.graph_of(np.concatenate([graph.edges, wide]))
        found, without = ([hull.area for hull in g.hulls(of.faces)[:1]] for of in (wider, graph))
        if sum(found) > 2 * sum(without):
            return wider, np.concatenate([joined, wide])
    return graph, joined


def _corners(polygon: Any) -> tuple[XY, ...]:
    """Return the corners of a polygon from its leftmost one on, without those where lines meet straight."""
    from vaoi_station.board_data.contours.graph import JOIN_MM

    ring = polygon.normalize().simplify(JOIN_MM).exterior
    return tuple((float(x), float(y)) for x, y in ring.coords[:0:-1])
