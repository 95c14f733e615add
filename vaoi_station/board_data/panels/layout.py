"""A panel with the parts and marks of its boards at their places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from heapq import nlargest
from typing import get_args

from vaoi_station.board_data.contours import area
from vaoi_station.board_data.conversion import MOST_CUT_OUTS, MOST_OUTLINE_POINTS
from vaoi_station.board_data.design import (
    XY,
    Design,
    Mark,
    Part,
    PlacedBoard,
    Placement,
    Side,
    extent,
    normalised,
)
from vaoi_station.board_data.marks import find_marks
from vaoi_station.errors import InputError
from vaoi_station.geometry.polygon import encloses
from vaoi_station.model.reason import Note

MOST_PARTS = 40_000
"""Largest number of parts on both sides of a panel: twice that of the components of a board type."""


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
    marks = [_of_board_below(_of_panel(mark), design.boards) for mark in _all_marks(design)]
    found: dict[int, tuple[list[Mark], list[_Sized]]] = {}
    contours: list[tuple[float, Placement, tuple[XY, ...]]] = []
    for board in design.boards:
        parts += [_placed_part(part, board) for part in board.design.parts]
        key = id(board.design)
        if key not in found:
            found[key] = _all_marks(board.design), _largest_cut_outs(board.design)
        marks += [_placed_mark(mark, board) for mark in found[key][0]]
        contours += ((size, board.at, contour) for size, contour in found[key][1])
    kept = nlargest(MOST_CUT_OUTS, contours, key=lambda c: c[0])
    cut_outs = (*design.cut_outs, *(tuple(map(at.apply, contour)) for _, at, contour in kept))
    left_out = sum(len(board.design.cut_outs) for board in design.boards) - len(kept)
    sentence = f"{left_out} contours of the boards are too many or too fine; they were left out."
    notes = [Note("contours-too-many", sentence, count=left_out)] if left_out else []
    laid = replace(design, parts=tuple(parts), marks=tuple(marks), cut_outs=cut_outs)
    return laid.with_notes(*notes)


_Sized = tuple[float, tuple[XY, ...]]
"""Area and corners of a contour."""


def _largest_cut_outs(design: Design) -> list[_Sized]:
    usable = ((abs(area(c)), c) for c in design.cut_outs if len(c) <= MOST_OUTLINE_POINTS)
    return nlargest(MOST_CUT_OUTS, usable, key=lambda c: c[0])


def _all_marks(design: Design) -> list[Mark]:
    """Return the marks of both sides of one design; those on both sides twice."""
    bare = replace(design, boards=())
    sides: tuple[Side, ...] = get_args(Side)
    return [
        replace(mark, side=side)
        for side in sides
        for mark in find_marks(bare, [part for part in design.parts if part.side == side], side)
    ]


def _of_panel(mark: Mark) -> Mark:
    """Return a mark of the panel itself; the panel's fiducials place it, unless they lie outside its outline."""
    return replace(mark, kind="global") if mark.kind == "panel" and mark.found_by != "place" else mark


def _of_board_below(mark: Mark, boards: Sequence[PlacedBoard]) -> Mark:
    """Return a mark of the panel; a bad-board mark with the position of the board on which it lies."""
    if mark.kind != "bad-board":
        return mark
    below = [b.position for b in boards if b.position and _lies_on(b.at.undo(mark.at), b.design.outline)]
    return replace(mark, panel=below[0]) if len(below) == 1 else mark


def _lies_on(point: XY, outline: Sequence[XY]) -> bool:
    if len(outline) < 3:
        return False
    (x0, y0), (x1, y1) = extent(outline)
    return x0 <= point[0] <= x1 and y0 <= point[1] <= y1 and encloses(outline, point)


def _placed_part(part: Part, board: PlacedBoard) -> Part:
    at, side, rotation, box = board.at, part.side, part.rotation, part.box
    if at.mirrored:
        side, rotation, box = _other(side), -rotation, box.mirrored() if box else None
    return replace(
        part,
        ref=part.ref if board.position else f"{board.name}/{part.ref}",
        side=side,
        origin=at.apply(part.origin),
        rotation=normalised(rotation + at.degrees),
        box=box,
        panel=board.position,
    )


def _placed_mark(mark: Mark, board: PlacedBoard) -> Mark:
    at, side = board.at, mark.side
    if at.mirrored and side is not None:
        side = _other(side)
    placed = replace(
        mark,
        name=f"{board.name}/{mark.name}",
        side=side,
        at=at.apply(mark.at),
        components=tuple(f"{board.name}/{ref}" for ref in mark.components),
    )
    return _of_panel(placed) if board.position is None else replace(placed, panel=board.position)


def _other(side: Side) -> Side:
    return "bottom" if side == "top" else "top"
