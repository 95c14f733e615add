"""Closed contours from lines and arcs: the outline of a board and its cut-outs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from vaoi_station.board_data.design import XY, Contour
from vaoi_station.model.reason import Note

CHORD_MM = 0.02
"""Largest distance of an arc from the lines that replace it."""


@dataclass(frozen=True)
class Contours:
    """What the lines of a drawing enclose; contours run counter-clockwise, without a repeated corner."""

    outline: Contour = ()
    """The largest outer contour; empty if the lines around all others are not closed."""
    others: tuple[Contour, ...] = ()
    """The cut-outs, and contours beside the outline; the largest first."""
    islands: tuple[Contour, ...] = ()
    """Contours within cut-outs."""
    notes: tuple[Note, ...] = ()


def find_contours(pieces: Iterable[Sequence[XY]], source: str) -> Contours:
    """Return the outline and the cut-outs that lines enclose, and notes on lines that were not used.

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
    from vaoi_station.board_data.contours.outline import contours_of

    return contours_of(drawn, source)


def arc_points(start: XY, end: XY, center: XY, clockwise: bool) -> list[XY]:
    """Return points along an arc, both ends included. Start equal to end is a full circle."""
    radius = math.dist(start, center)
    first, last = (math.atan2(p[1] - center[1], p[0] - center[0]) for p in (start, end))
    sweep = (first - last if clockwise else last - first) % (2 * math.pi) or 2 * math.pi
    if math.dist(start, end) < 1e-9:
        sweep = 2 * math.pi
    step = 2 * math.acos(max(0.0, 1 - CHORD_MM / radius)) if radius > CHORD_MM else math.pi / 2
    count = max(2, math.ceil(sweep / max(step, 0.02)))
    if math.isclose(sweep, 2 * math.pi):
        count += -count % 4  # so that the extreme points of a circle are among them
    angles = (first + (-sweep if clockwise else sweep) * k / count for k in range(1, count))
    return [start, *((center[0] + radius * math.cos(a), center[1] + radius * math.sin(a)) for a in angles), end]


def arc_through(start: XY, middle: XY, end: XY) -> list[XY]:
    """Return points along the arc through three points; a straight line if they lie on one."""
    (ax, ay), (bx, by), (cx, cy) = start, middle, end
    d = 2 * (ax * (by - cy) + bx * (cy - ay) + cx * (ay - by))
    if abs(d) < 1e-12:
        return [start, middle, end]
    a2, b2, c2 = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    x = (a2 * (by - cy) + b2 * (cy - ay) + c2 * (ay - by)) / d
    y = (a2 * (cx - bx) + b2 * (ax - cx) + c2 * (bx - ax)) / d
    return arc_points(start, end, (x, y), clockwise=d < 0)


def circle_points(center: XY, radius: float) -> list[XY]:
    """Return points around a circle; the last equals the first."""
    at = (center[0] + radius, center[1])
    return arc_points(at, at, center, clockwise=False)


def area(contour: Sequence[XY]) -> float:
    """Return the signed area of a contour, mm²; positive if it runs counter-clockwise."""
    shifted = [*contour[1:], contour[0]] if contour else []
    return sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(contour, shifted, strict=True)) / 2
