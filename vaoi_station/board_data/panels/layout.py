"""A panel with the parts and marks of its boards at their places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from heapq import nlargest

from vaoi_station.board_data.contours import area
from vaoi_station.board_data.conversion import MOST_CUT_OUTS, MOST_OUTLINE_POINTS
from vaoi_station.board_data.design import (
    Contour,
    Design,
    Mark,
    NetPoint,
    Part,
    PlacedBoard,
    Placement,
    Side,
    extent,
    normalised,
    noted,
)
from vaoi_station.board_data.marks import all_marks
from vaoi_station.errors import InputError
from vaoi_station.geometry.polygon import encloses
from vaoi_station.model.board_type import MOST_POINTS

MOST_PARTS = 40_000
"""Largest number of parts on both sides of a panel: twice that of the components of a board type."""
_OTHER: dict[Side, Side] = {"top": "bottom", "bottom": "top"}


def laid_out(design: Design) -> Design:
    """Return a panel with the parts and marks of its boards; a design without boards as it is.

    The marks of both sides are found before, on each design by itself, so that they are final. Fiducials of the panel
    itself place the panel. A bad-board mark of the panel belongs to the board within whose outline it lies.

    Raises:
        InputError: the panel has too many parts.
    """
    if not design.boards:
        return design
    count = len(design.parts) + sum(len(board.design.parts) for board in design.boards)
    if count > MOST_PARTS:
        raise InputError.field(design.name, "the number of parts of the panel", count, f"at most {MOST_PARTS}")
    parts = list(design.parts)
    marks = [_of_board_below(_of_panel(mark), design.boards) for mark in all_marks(design)]
    found: dict[int, tuple[list[Mark], list[tuple[float, Contour]]]] = {}
    contours: list[tuple[float, Placement, Contour]] = []
    for board in design.boards:
        parts += [_placed_part(part, board) for part in board.design.parts]
        if (key := id(board.design)) not in found:
            sized = ((abs(area(c)), c) for c in board.design.cut_outs if len(c) <= MOST_OUTLINE_POINTS)
            largest = nlargest(MOST_CUT_OUTS, sized, key=lambda c: c[0])
            found[key] = all_marks(board.design), largest
        marks += [_placed_mark(mark, board) for mark in found[key][0]]
        contours += ((size, board.at, contour) for size, contour in found[key][1])
    kept = nlargest(MOST_CUT_OUTS, contours, key=lambda c: c[0])
    cut_outs = (*design.cut_outs, *(tuple(map(at.apply, contour)) for _, at, contour in kept))
    points = list(design.net_points)
    if (count := sum(len(board.design.net_points) for board in design.boards)) > 2 * MOST_POINTS:
        text = "the panel has {count} test points, more than {most}; they were left out."
        design = design.with_notes(noted("net-points-left-out", text, count=count, most=2 * MOST_POINTS))
    else:
        points += (_placed_point(point, board) for board in design.boards for point in board.design.net_points)
    laid = replace(design, parts=tuple(parts), marks=tuple(marks), cut_outs=cut_outs, net_points=tuple(points))
    if left_out := sum(len(board.design.cut_outs) for board in design.boards) - len(kept):
        text = "{count} contours of the boards are too many or too fine; they were left out."
        laid = laid.with_notes(noted("contours-too-many", text, count=left_out))
    return laid


def _of_panel(mark: Mark) -> Mark:
    """Return a mark of the panel itself; the panel's fiducials place it, unless they lie outside its outline."""
    return replace(mark, kind="global") if mark.kind == "panel" and mark.found_by != "place" else mark


def _of_board_below(mark: Mark, boards: Sequence[PlacedBoard]) -> Mark:
    """Return a mark of the panel; a bad-board mark with the position of the board on which it lies."""
    below = []
    for board in boards if mark.kind == "bad-board" else ():
        (x, y), outline = board.at.undo(mark.at), board.design.outline
        if board.position and len(outline) > 2:
            (x0, y0), (x1, y1) = extent(outline)
            below += [board.position] if x0 <= x <= x1 and y0 <= y <= y1 and encloses(outline, (x, y)) else []
    return replace(mark, panel=below[0]) if len(below) == 1 else mark


def _placed_part(part: Part, board: PlacedBoard) -> Part:
    at, side, rotation, box = board.at, part.side, part.rotation, part.box
    if at.mirrored:
        side, rotation, box = _OTHER[side], -rotation, box.mirrored() if box else None
    ref = part.ref if board.position else f"{board.name}/{part.ref}"
    rotation, origin = normalised(rotation + at.degrees), at.apply(part.origin)
    return replace(part, ref=ref, side=side, origin=origin, rotation=rotation, box=box, panel=board.position)


def _placed_point(point: NetPoint, board: PlacedBoard) -> NetPoint:
    top, bottom = (point.on_bottom, point.on_top) if board.at.mirrored else (point.on_top, point.on_bottom)
    name = f"{board.name}/{point.name}"
    return point._replace(name=name, at=board.at.apply(point.at), on_top=top, on_bottom=bottom)


def _placed_mark(mark: Mark, board: PlacedBoard) -> Mark:
    side = _OTHER[mark.side] if board.at.mirrored and mark.side is not None else mark.side
    refs = tuple(f"{board.name}/{ref}" for ref in mark.components)
    name = f"{board.name}/{mark.name}"
    placed = replace(mark, name=name, side=side, at=board.at.apply(mark.at), components=refs)
    return _of_panel(placed) if board.position is None else replace(placed, panel=board.position)
