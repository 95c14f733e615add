"""Add the points of a netlist to a design: the shift between both files is found by the pads of the parts."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vaoi_station.board_data.design import XY, Design, NetPoint, Side, extent, noted
from vaoi_station.errors import InputError

_SAME_MM = 0.03
"""Largest difference of the shifts of two parts whose pads lie evenly about their middle."""
_LEAST, _MOST = 3, 2000
"""Parts that must agree about the shift, and parts that are compared."""
_LETTERS = 6
"""A netlist has this many letters of a designator."""


def with_net_points(design: Design, points: Sequence[NetPoint], side: Side) -> Design:
    """Return the design with the points that a probe reaches on a side, in its coordinates.

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
    moved = tuple(
        point._replace(at=(point.at[0] + dx, point.at[1] + dy))
        for point in points
        if (point.on_bottom if side == "bottom" else point.on_top)
    )
    text = "{count} test points were added from the netlist, shifted by ({shift_mm}) mm: {agree} of {all} parts agree."
    values = {"count": len(moved), "shift_mm": f"{dx:.3f}, {dy:.3f}", "agree": int(best.sum()), "all": len(known)}
    return replace(design, net_points=moved).with_notes(noted("net-points-added", text, **values))
