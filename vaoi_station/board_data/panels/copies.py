"""Recognise a panel in a file that has every board's parts under the same designators, as KiKit writes it.

A designator that occurs once on each board shows where the boards are by its places and rotations. All other
designators lie, seen from it, at the same place on every board. Boards that are turned against each other may allow
several such places, of two boards each by 180° always two: then nothing states which part is of which board.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import product
from math import dist
from typing import NamedTuple

import numpy as np

from vaoi_station.board_data.design import (
    XY,
    Design,
    Mark,
    NetPoint,
    Part,
    PlacedBoard,
    Placement,
    angle_between,
    extent,
    noted,
    rotated,
)
from vaoi_station.board_data.net_points import numbered
from vaoi_station.board_data.panels.layout import MOST_PARTS
from vaoi_station.board_data.panels.step_and_repeat import MOST_BOARDS

SAME_PLACE_MM = 0.05
"""A part and the place where a copy is expected may differ by this; files of placement machines round to 10 µm."""
SAME_ANGLE_DEG = 0.5
LEAST_MATCHED = 0.9
"""Least share of the repeated designators whose parts must be copies of one another."""
_MOST_NEAR, _MOST_PAIRS = 32, 500_000
"""Number of the nearest parts to which a pad may belong, and of pairs of a pad and a part that are compared at once."""
MOST_ANCHORS = 5
"""Largest number of designators that are tried as the one that shows where the boards are."""


class _Member(NamedTuple):
    """A part or a mark of a panel."""

    of: Part | Mark
    at: XY
    degrees: float


def with_copies(design: Design) -> Design:
    """Return the panel that a design is if its parts are copies of one board; any other design as it is."""
    # `REF**` and `G***` are footprints that KiCad has not numbered: holes, logos, bridges between boards.
    parts = _grouped((p.ref, _Member(p, p.origin, p.rotation)) for p in design.parts if not p.ref.endswith("*"))
    counts = Counter(len(group) for group in parts.values() if len(group) > 1)
    if design.boards or 2 * counts.total() <= len(parts) or len(design.parts) > MOST_PARTS:
        return design
    number = max(counts, key=lambda count: (counts[count], count))
    groups = [group for group in parts.values() if len(group) == number]
    least = max(2.0, LEAST_MATCHED * counts.total())
    if number > MOST_BOARDS or len(groups) < least:
        return design
    marks = _grouped((mark.name, _Member(mark, mark.at, 0.0)) for mark in design.marks)
    anchors = [group for group in groups if len({member.of.side for member in group}) == 1]
    for anchor in anchors[:MOST_ANCHORS]:
        placed = [found for group in groups if (found := _placed(anchor, group))]
        if len(placed) >= least:
            placed += [found for group in marks.values() if len(group) == number and (found := _placed(anchor, group))]
            return _panel(design, list(zip(*placed, strict=True)))
    return design


def _grouped(members: Iterable[tuple[str, _Member]]) -> dict[str, list[_Member]]:
    groups: defaultdict[str, list[_Member]] = defaultdict(list)
    for name, member in members:
        groups[name].append(member)
    return groups


def _panel(design: Design, boards: Sequence[Sequence[_Member]]) -> Design:
    used, placed = {id(member.of) for board in boards for member in board}, []
    order = _in_rows([extent(member.at for member in board) for board in boards])
    points = _shared_out(design.net_points, [boards[k] for k in order])
    for n, k in enumerate(order, 1):
        of = [member.of for member in boards[k]]
        parts, marks = tuple(p for p in of if isinstance(p, Part)), tuple(m for m in of if isinstance(m, Mark))
        board = Design(design.name, design.format, parts, marks=marks, net_points=numbered(points[n]))
        placed.append(PlacedBoard(str(n), str(n), board, Placement()))
    text = (
        "designators occur {count} times, at places that are copies of one another: the file was read as a panel of "
        "{count} boards, whose positions count from 1, from left to right, then upwards."
    )
    parts = tuple(part for part in design.parts if id(part) not in used)
    marks = tuple(mark for mark in design.marks if id(mark) not in used)
    panel = replace(design, parts=parts, marks=marks, net_points=numbered(points[0]), boards=tuple(placed))
    return panel.with_notes(noted("read-as-panel", text, count=len(boards)))


def _shared_out(points: Sequence[NetPoint], boards: Sequence[Sequence[_Member]]) -> dict[int, list[NetPoint]]:
    """Return the test points of each board, from 1, and of the panel, 0.

    A pad is of the board on which it lies beside the part of its designator as on the others, a via of the nearest one.
    """
    places: defaultdict[str, list[tuple[_Member, int]]] = defaultdict(list)
    boxes = [extent(member.at for member in board) for board in boards]
    for n, board in enumerate(boards, 1):
        for member in board:
            if isinstance(member.of, Part):
                places[member.of.ref].append((member, n))
    pads: defaultdict[tuple[str, str], list[int]] = defaultdict(list)
    for k, point in enumerate(points):
        if point.ref in places:
            pads[point.ref, point.pin].append(k)
    board_of = dict[int, int]()
    for (ref, _), of in pads.items():
        chosen = _parts_of_pads([points[k].at for k in of], [member for member, _ in places[ref]])
        board_of |= {k: places[ref][part][1] for k, part in zip(of, chosen, strict=True)}
    found: dict[int, list[NetPoint]] = {n: [] for n in range(len(boards) + 1)}
    for k, point in enumerate(points):
        n = board_of.get(k, 0)
        if not point.ref:
            beside = [[max(a - c, c - b, 0.0) for a, b, c in zip(*box, point.at, strict=True)] for box in boxes]
            n = 1 + min(range(len(boxes)), key=lambda k: sum(d * d for d in beside[k]))
        stated = not point.ref and point.kind != "via"
        found[n].append(point if stated else point._replace(name=""))
    return found


def _parts_of_pads(pads: Sequence[XY], parts: Sequence[_Member]) -> list[int]:
    """Return the index of the part that each pad belongs to; all are of one pin of the copies of one part.

    Seen from its own part, a pad lies where those of the other copies lie. Where this leaves several parts, the nearest
    one is taken: that alone would be wrong for a connector whose origin is at one end.
    """
    places = np.array([complex(*part.at) for part in parts])
    turned_back = np.exp(-1j * np.radians([part.degrees for part in parts]))
    count = min(_MOST_NEAR, len(parts))
    near, seen = [], []
    # In blocks, so that they need little memory.
    for block in np.array_split([complex(*at) for at in pads], 1 + len(pads) * len(parts) // _MOST_PAIRS):
        away = block[:, None] - places
        nearest = np.sort(np.argpartition(np.abs(away), count - 1, axis=1)[:, :count], axis=1)
        near.append(nearest)
        seen.append(np.take_along_axis(away, nearest, 1) * turned_back[nearest])
    at = np.concatenate(seen)
    alike = np.zeros(at.shape, np.intp)
    # Two places that are nearly the same are in one cell of at least one of these grids.
    for across, up in product((0.0, 0.5), repeat=2):
        cells = np.floor(at.real / (2 * SAME_PLACE_MM) + across) + 1j * np.floor(at.imag / (2 * SAME_PLACE_MM) + up)
        _, cell, counts = np.unique(cells, return_inverse=True, return_counts=True)
        alike = np.maximum(alike, counts[cell].reshape(at.shape))
    chosen = np.where(alike == alike.max(1, keepdims=True), np.abs(at), np.inf).argmin(1)
    return [int(part) for part in np.take_along_axis(np.concatenate(near), chosen[:, None], 1)[:, 0]]


def _placed(anchor: Sequence[_Member], group: Sequence[_Member]) -> tuple[_Member, ...]:
    """Return a group in the order of the boards, of which `anchor` has one part each.

    It is empty if the group has no common place on the boards, or several.
    """
    cells = {_cell(member.at): member for member in group}
    # Boards do not lie on one another; a search among many parts at one place would take long.
    if len(cells) < len(group):
        return ()
    first, found = anchor[0], []
    for start in group:
        offset = rotated((start.at[0] - first.at[0], start.at[1] - first.at[1]), -first.degrees)
        members = []
        for part in anchor:
            dx, dy = rotated(offset, part.degrees)
            turn = start.degrees - first.degrees + part.degrees
            copy = _at(cells, (part.at[0] + dx, part.at[1] + dy), turn, start)
            if copy is None:
                break
            members.append(copy)
        if len({id(member.of) for member in members}) == len(anchor):
            found.append(tuple(members))
    return found[0] if len(found) == 1 else ()


def _at(cells: dict[tuple[int, int], _Member], at: XY, turn: float, like: _Member) -> _Member | None:
    """Return the member at a place, of the same side and rotation as its copy."""
    column, row = _cell(at)
    for cell in product((column - 1, column, column + 1), (row - 1, row, row + 1)):
        member = cells.get(cell)
        if member is None or member.of.side != like.of.side or dist(member.at, at) > SAME_PLACE_MM:
            continue
        if isinstance(member.of, Mark) or angle_between(member.degrees, turn) <= SAME_ANGLE_DEG:
            return member
    return None


def _in_rows(boxes: Sequence[tuple[XY, XY]]) -> list[int]:
    """Return the indices of boxes row by row, from the lowest; in a row from left to right."""
    middle = [((low[0] + high[0]) / 2, (low[1] + high[1]) / 2) for low, high in boxes]
    height = max(1.0, *(high[1] - low[1] for low, high in boxes))
    rows: list[list[int]] = []
    for k in sorted(range(len(boxes)), key=lambda k: middle[k][1]):
        if rows and middle[k][1] - middle[rows[-1][0]][1] <= height / 2:
            rows[-1].append(k)
        else:
            rows.append([k])
    return [k for row in rows for k in sorted(row, key=lambda k: middle[k][0])]


def _cell(at: XY) -> tuple[int, int]:
    return round(at[0] / (2 * SAME_PLACE_MM)), round(at[1] / (2 * SAME_PLACE_MM))
