"""The points of nets that a probe can reach: their names, and those of a netlist that is joined with a design.

The shift between both files is found by the pads of the parts.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from vaoi_station.board_data.design import XY, Design, NetPoint, Side, extent, noted
from vaoi_station.errors import InputError
from vaoi_station.model.reason import Note

NOTES = frozenset({"vias-mask-unknown", "pads-without-opening", "pad-sides-unclear"})
"""Codes of the notes about points that the file itself has."""
_SAME_MM = 0.03
"""Largest difference of the shifts of two parts whose pads lie evenly about their middle."""
_LEAST, _MOST = 3, 2000
"""Parts that must agree about the shift, and parts that are compared."""
_LETTERS = 6
"""A netlist has this many letters of a designator."""
_CELL_MM = 0.02
_CONTROL = re.compile(r"[\x00-\x1f\x7f]+")
_MOST_NAME = 180


class Openings:
    """Places, such as those where solder mask is open."""

    def __init__(self, places: Iterable[XY]) -> None:
        self._cells = {_cell(at) for at in places}

    def __contains__(self, at: XY) -> bool:
        """Return whether there is one at a place, give or take a rounding of the file."""
        column, row = _cell(at)
        return any((column + i, row + k) in self._cells for i in (0, -1, 1) for k in (0, -1, 1))


def _cell(at: XY) -> tuple[int, int]:
    return round(at[0] / _CELL_MM), round(at[1] / _CELL_MM)


def unmasked(points: Iterable[NetPoint], openings: Mapping[Side, Openings]) -> tuple[list[NetPoint], list[Note]]:
    """Return points, vias out of reach on the sides on which solder mask covers them, and notes.

    A side without openings is not known. Pads are in reach: their opening may be larger, that of a row of pads.
    """
    found, without = [], list[str]()
    for point in points:
        closed = [s for s in openings if point.on_side(s) and point.at not in openings[s]]
        top, bottom = point.on_top and "top" not in closed, point.on_bottom and "bottom" not in closed
        found.append(point if point.ref else point._replace(on_top=top, on_bottom=bottom))
        if closed and point.ref:
            without.append(f"{point.ref}-{point.pin}")
    notes = vias_without_mask(found, openings)
    if without:
        text = (
            "{count} pads have no opening of solder mask at their middle; they are test points nevertheless: {names}."
        )
        notes.append(noted("pads-without-opening", text, count=len(without), names=without))
    return found, notes


def vias_without_mask(points: Iterable[NetPoint], stated: Container[Side]) -> list[Note]:
    """Return a note if there are vias on a side whose solder mask the file does not state."""
    sides: tuple[Side, ...] = ("top", "bottom")
    unknown = [[s for s in sides if s not in stated and p.on_side(s)] for p in points if p.kind == "via"]
    count, found = sum(map(bool, unknown)), sorted({s for of in unknown for s in of}, reverse=True)
    text = (
        "the file does not state which of its {count} vias solder mask covers on the {sides}; there all count as test "
        "points."
    )
    return [noted("vias-mask-unknown", text, count=count, sides=" and ".join(found))] if count else []


def numbered(points: Iterable[NetPoint]) -> tuple[NetPoint, ...]:
    """Return the points that a probe reaches on a side, with their names: `U1-3`, `VIA GND`, `VIA GND#2`.

    Points that none reaches are counted, so that a name does not depend on the mask.
    """
    counts, names, out = Counter[str](), set[str](), []
    for point in points:
        stated = point.name or (f"{point.ref}-{point.pin}" if point.pin else f"{point.ref or 'VIA'} {point.net}")
        base = _CONTROL.sub(" ", stated).strip()[:_MOST_NAME] or "VIA"
        counts[base] += 1
        if not (point.on_top or point.on_bottom):
            continue
        name = base if counts[base] == 1 else f"{base}#{counts[base]}"
        while name in names:  # a pad may be named like this
            counts[base] += 1
            name = f"{base}#{counts[base]}"
        names.add(name)
        out.append(point._replace(name=name))
    return tuple(out)


def with_net_points(design: Design, points: Sequence[NetPoint], side: Side) -> Design:
    """Return the design with the points of a netlist, in its coordinates, by the parts of one side.

    Raises:
        InputError: the design is a panel, or the pads of the netlist are not those of its parts.
    """
    if design.boards:
        raise InputError(
            f"{design.name!r} is a panel of {len(design.boards)} boards; a netlist is of one board.",
            action="Import the board by --step, without --repeat.",
        )
    parts, pads = design.parts_on(side), defaultdict[str, list[XY]](list)
    for point in points:
        if point.ref:
            pads[point.ref].append(point.at)
    counts = Counter(part.ref[:_LETTERS] for part in parts)
    shifts = []
    for part in parts:
        at = pads.get(part.ref[:_LETTERS], [])
        if len(at) > 1 and counts[part.ref[:_LETTERS]] == 1:
            (x0, y0), (x1, y1) = extent(at)
            shifts.append((part.center[0] - (x0 + x1) / 2, part.center[1] - (y0 + y1) / 2))
    known = np.array(shifts[:_MOST]).reshape(-1, 2)
    agree = (np.abs(known[:, None] - known).max(2) <= _SAME_MM) if len(known) else np.zeros((0, 0), np.bool_)
    best = agree[agree.sum(1).argmax()] if len(known) else np.zeros(0, np.bool_)
    if best.sum() < _LEAST:
        raise InputError(
            f"the netlist fits {int(best.sum())} of {len(known)} parts of {design.name!r} that both have on the "
            f"{side}; {_LEAST} must agree about its shift.",
            action="Export both files from the same board.",
        )
    dx, dy = np.median(known[best], axis=0).tolist()
    moved = tuple(point._replace(at=(point.at[0] + dx, point.at[1] + dy)) for point in points)
    text = "{count} test points were added from the netlist, shifted by ({shift_mm}) mm: {agree} of {all} parts agree."
    values = {
        "count": sum(p.on_side(side) for p in moved),
        "shift_mm": f"{dx:.3f}, {dy:.3f}",
        "agree": int(best.sum()),
        "all": len(known),
    }
    return replace(design, net_points=moved).with_notes(noted("net-points-added", text, **values))
