"""Recognise a panel in a file that has every board's parts under the same designators, as KiKit writes it.

A designator that occurs once on each board shows where the boards are by its places and rotations. All other
designators lie, seen from it, at the same place on every board. Boards that are turned against each other may allow
several such places, of two boards each by 180° always two: then nothing states which part is of which board.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from math import dist

from vaoi_station.board_data.design import XY, Design, Mark, Part, PlacedBoard, Placement, extent, rotated
from vaoi_station.board_data.panels.layout import MOST_PARTS
from vaoi_station.board_data.panels.step_and_repeat import MOST_BOARDS
from vaoi_station.model.reason import Note

SAME_PLACE_MM = 0.05
"""A part and the place where a copy is expected may differ by this; files of placement machines round to 10 µm."""
SAME_ANGLE_DEG = 0.5
LEAST_MATCHED = 0.9
"""Least share of the repeated designators whose parts must be copies of one another."""
MOST_ANCHORS = 5
"""Largest number of designators that are tried as the one that shows where the boards are."""
_NOWHERE = Placement(False, 0.0, (0.0, 0.0))


def with_copies(design: Design) -> Design:
    """Return the panel that a design is if its parts are copies of one board; any other design as it is."""
    parts: defaultdict[str, list[Part | Mark]] = defaultdict(list)
    for part in design.parts:
        # `REF**` and `G***` are footprints that KiCad has not numbered: holes, logos, bridges between boards.
        if not part.ref.endswith("*"):
            parts[part.ref].append(part)
    counts = Counter(len(group) for group in parts.values() if len(group) > 1)
    if design.boards or 2 * counts.total() <= len(parts) or len(design.parts) > MOST_PARTS:
        return design
    number = max(counts, key=lambda count: (counts[count], count))
    groups = {ref: group for ref, group in parts.items() if len(group) == number}
    least = max(2.0, LEAST_MATCHED * counts.total())
    if number > MOST_BOARDS or len(groups) < least:
        return design
    marks: defaultdict[str, list[Part | Mark]] = defaultdict(list)
    for mark in design.marks:
        marks[mark.name].append(mark)
    anchors = [group for group in groups.values() if len({part.side for part in group}) == 1]
    for anchor in anchors[:MOST_ANCHORS]:
        placed = [found for group in groups.values() if (found := _placed(anchor, group))]
        if len(placed) >= least:
            placed += [found for group in marks.values() if len(group) == number and (found := _placed(anchor, group))]
            return _panel(design, list(zip(*placed, strict=True)))
    return design


def _panel(design: Design, boards: Sequence[Sequence[Part | Mark]]) -> Design:
    """Return the design as a panel; its boards are numbered from left to right, then upwards."""
    used = {id(member) for board in boards for member in board}
    placed = []
    for n, k in enumerate(_in_rows([extent(_place(member) for member in board) for board in boards]), 1):
        one = Design(
            design.name,
            design.format,
            tuple(member for member in boards[k] if isinstance(member, Part)),
            marks=tuple(member for member in boards[k] if isinstance(member, Mark)),
        )
        placed.append(PlacedBoard(str(n), str(n), one, _NOWHERE))
    sentence = (
        f"designators occur {len(boards)} times, at places that are copies of one another: the file was read as a "
        f"panel of {len(boards)} boards, whose positions count from 1, from left to right, then upwards."
    )
    parts = tuple(part for part in design.parts if id(part) not in used)
    marks = tuple(mark for mark in design.marks if id(mark) not in used)
    return replace(design, parts=parts, marks=marks, boards=tuple(placed)).with_notes(
        Note("read-as-panel", sentence, count=len(boards))
    )


def _placed(anchor: Sequence[Part | Mark], group: Sequence[Part | Mark]) -> tuple[Part | Mark, ...]:
    """Return a group in the order of the boards, of which `anchor` has one part each.

    It is empty if the group has no common place on the boards, or several.
    """
    cells: defaultdict[tuple[int, int], list[Part | Mark]] = defaultdict(list)
    for member in group:
        cells[_cell(_place(member))].append(member)
    # Boards do not lie on one another; a search among many parts at one place would take long.
    if max(map(len, cells.values())) > 1:
        return ()
    first = anchor[0]
    found = []
    for start in group:
        (x, y), (x0, y0) = _place(start), _place(first)
        offset = rotated((x - x0, y - y0), -_angle(first))
        members = []
        for part in anchor:
            dx, dy = rotated(offset, _angle(part))
            at = _place(part)[0] + dx, _place(part)[1] + dy
            copy = _at(cells, at, _angle(start) - _angle(first) + _angle(part), start)
            if copy is None:
                break
            members.append(copy)
        if len({id(member) for member in members}) == len(anchor):
            found.append(tuple(members))
    return found[0] if len(found) == 1 else ()


def _at(cells: dict[tuple[int, int], list[Part | Mark]], at: XY, turn: float, like: Part | Mark) -> Part | Mark | None:
    """Return the member at a place, of the same side and rotation as its copy."""
    column, row = _cell(at)
    for cell in product((column - 1, column, column + 1), (row - 1, row, row + 1)):
        for member in cells.get(cell, ()):
            same = member.side == like.side and dist(_place(member), at) <= SAME_PLACE_MM
            if same and (isinstance(member, Mark) or abs((_angle(member) - turn + 180) % 360 - 180) <= SAME_ANGLE_DEG):
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


def _place(member: Part | Mark) -> XY:
    return member.origin if isinstance(member, Part) else member.at


def _angle(member: Part | Mark) -> float:
    return member.rotation if isinstance(member, Part) else 0.0
