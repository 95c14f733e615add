"""Closed contours from lines and arcs: the outline of a board and its cut-outs."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence

from vaoi_station.board_data.design import XY

JOIN_MM = 0.02
"""Ends of two lines that are nearer than this are one corner; CAD systems round coordinates."""
CHORD_MM = 0.02
"""Largest distance of an arc from the lines that replace it."""


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
    center = (
        (a2 * (by - cy) + b2 * (cy - ay) + c2 * (ay - by)) / d,
        (a2 * (cx - bx) + b2 * (ax - cx) + c2 * (bx - ax)) / d,
    )
    return arc_points(start, end, center, clockwise=d < 0)


def circle_points(center: XY, radius: float) -> list[XY]:
    """Return points around a circle; the last equals the first."""
    at = (center[0] + radius, center[1])
    return arc_points(at, at, center, clockwise=False)


def area(contour: Sequence[XY]) -> float:
    """Return the signed area of a contour, mm²; positive if it runs counter-clockwise."""
    shifted = [*contour[1:], contour[0]] if contour else []
    return sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(contour, shifted, strict=True)) / 2


def join(pieces: Iterable[Sequence[XY]]) -> tuple[list[list[XY]], int]:
    """Join pieces at common ends.

    Returns:
        The closed contours without a repeated last corner, the largest first, and the number of pieces that close no
        contour.
    """
    left = _Pieces([piece for piece in pieces if len(piece) > 1])
    closed: list[list[XY]] = []
    open_count = 0
    while (first := left.take()) is not None:
        chain, count = list(first), 1
        while math.dist(chain[0], chain[-1]) > JOIN_MM or len(chain) < 4:
            near = left.take_from(chain[-1])
            if near is None:
                break
            count += 1
            chain += near[1:]
        if math.dist(chain[0], chain[-1]) <= JOIN_MM and abs(area(chain)) > 1e-3:
            closed.append(chain[:-1])
        else:
            open_count += count
    return sorted(closed, key=lambda c: -abs(area(c))), open_count


class _Pieces:
    """Pieces with their ends in a grid, so that one that begins at a place is found among its neighbours."""

    def __init__(self, pieces: Sequence[Sequence[XY]]) -> None:
        self._left = dict(enumerate(pieces))
        # Cell → (number of a piece, whether its last point is meant); dictionaries keep the order and lose any entry.
        self._ends: defaultdict[tuple[int, int], dict[tuple[int, bool], XY]] = defaultdict(dict)
        for n, piece in self._left.items():
            for last in (False, True):
                end = piece[-1 if last else 0]
                self._ends[_cell(end)][n, last] = end

    def take(self) -> Sequence[XY] | None:
        """Remove and return the last piece; None if there is none."""
        return self._without_ends(*self._left.popitem()) if self._left else None

    def take_from(self, at: XY) -> Sequence[XY] | None:
        """Remove the piece with the nearest end, and return it from there on; None if none is near."""
        column, row = _cell(at)
        best: tuple[float, int, bool] | None = None
        for x in (column, column - 1, column + 1):
            for y in (row, row - 1, row + 1):
                for (n, last), end in self._ends.get((x, y), {}).items():
                    distance = math.dist(end, at)
                    if distance <= JOIN_MM and (best is None or (distance, n, last) < best):
                        best = (distance, n, last)
                    if distance == 0:
                        break  # there is none nearer; thousands of lines may begin at one place
        if best is None:
            return None
        piece = self._without_ends(best[1], self._left.pop(best[1]))
        return piece[::-1] if best[2] else piece

    def _without_ends(self, n: int, piece: Sequence[XY]) -> Sequence[XY]:
        for last in (False, True):
            del self._ends[_cell(piece[-1 if last else 0])][n, last]
        return piece


def _cell(point: XY) -> tuple[int, int]:
    return math.floor(point[0] / JOIN_MM), math.floor(point[1] / JOIN_MM)
