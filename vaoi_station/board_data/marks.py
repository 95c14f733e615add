"""Fiducials and other marks of a design: which there are, of which kind, and how each was found.

A file may mark them by elements, by attributes of pads, or not at all; then names of parts and packages, and places,
decide.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import get_args

from vaoi_station.board_data.design import XY, Design, FoundBy, Mark, MarkKind, Part, Side
from vaoi_station.geometry.polygon import encloses

MOST_MARKS = 60
"""Above this number pairs are not compared with bodies: the time grows with the square. No board has as many."""
SAME_MARK_MM = 0.1
"""Two marks that are nearer than this are one; a board type refuses both."""
LEAST_GLOBAL = 2
LEAST_LOCAL_BODY_MM = 4.0
"""Bodies that are smaller along both axes have no local fiducials of their own."""
FARTHEST_LOCAL_MM = 6.0
"""Largest distance of a local fiducial from the body that it belongs to, beyond the body's corners."""
CENTERED_MM = 0.5
"""A pair of local fiducials has its middle at the centre of their body; CAD systems place them so within this."""

_NAME = re.compile(r"^(FID|FD|FM|MARK|FIDUCIAL|[LP]FID|FID[LP]|BBM|XOUT)[-_ ]?\d*$", re.IGNORECASE)
_PACKAGE = re.compile(r"fid(ucial)?([^a-z]|$)|fiducial|bad[-_ ]?(board|mark)", re.IGNORECASE)
_KINDS: tuple[tuple[MarkKind, re.Pattern[str]], ...] = (
    ("bad-board", re.compile(r"bad[-_ ]?(board|mark)|x[-_]?out|skip[-_ ]?mark|^BBM", re.IGNORECASE)),
    ("panel", re.compile(r"panel|^PFID|^FIDP", re.IGNORECASE)),
    ("local", re.compile(r"local|^LFID|^FIDL", re.IGNORECASE)),
)
_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*mm", re.IGNORECASE)
"""The diameter in a name such as `Fiducial_0.75mm_Mask1.5mm`."""


def find_marks(design: Design, side: Side) -> list[Mark]:
    """Return the marks of a side, at most one at every place: elements of the file first, names last.

    A mark outside the outline belongs to the panel if enough others lie inside. On a panel whose boards are laid out
    all marks are known.
    """
    return [mark for mark in design.marks if mark.side == side] if design.boards else _marks_of_board(design, side)


def all_marks(design: Design) -> list[Mark]:
    """Return the marks of both sides of a design by itself, without its boards; those on both sides twice."""
    return [replace(mark, side=side) for side in get_args(Side) for mark in _marks_of_board(design, side)]


def _marks_of_board(design: Design, side: Side) -> list[Mark]:
    parts = design.parts_on(side)
    explicit = [mark for mark in design.marks if mark.side in (side, None)]
    marked = [_of_part(part, "package") for part in parts if part.is_mark]
    named = [_of_part(p, "name") for p in parts if _NAME.match(p.ref) or _PACKAGE.search(p.package)]
    found: list[Mark] = []
    for source in (explicit, marked, named):
        has_global = any(mark.kind == "global" for mark in found)
        for mark in source:
            same = any(math.dist(mark.at, other.at) < SAME_MARK_MM for other in found)
            # What a file marks by itself is complete; a part that has only such a name may be anything.
            if not same and not (has_global and mark.kind == "global"):
                found.append(mark)
    return _with_components(_with_marks_of_the_panel(found, design.outline), parts)


def kind_by_name(*texts: str) -> MarkKind:
    """Return the kind of a mark from its name, package or attribute."""
    return next((kind for kind, pattern in _KINDS for text in texts if pattern.search(text)), "global")


def _of_part(part: Part, found_by: FoundBy) -> Mark:
    kind, diameter = part.mark_kind or kind_by_name(part.ref, part.package), part.mark_diameter
    if not diameter and (stated := _SIZE.search(part.package)) and 0.05 <= float(stated[1]) <= 50:
        diameter = float(stated[1])
    return Mark(part.ref, part.side, part.origin, diameter, kind, "attribute" if part.mark_kind else found_by)


def _with_marks_of_the_panel(marks: list[Mark], outline: Sequence[XY]) -> list[Mark]:
    """Return the marks, those outside the outline as marks of the panel, if enough global ones lie inside."""
    inside = [len(outline) < 3 or encloses(outline, mark.at) for mark in marks]
    if sum(mark.kind == "global" for mark, within in zip(marks, inside, strict=True) if within) < LEAST_GLOBAL:
        return marks
    return [
        mark if within or mark.kind in ("panel", "bad-board") else replace(mark, kind="panel", found_by="place")
        for mark, within in zip(marks, inside, strict=True)
    ]


def _with_components(marks: list[Mark], parts: Sequence[Part]) -> list[Mark]:
    """Return the marks, local ones with the components that they belong to.

    They belong to a component that their name contains (`FID_U1`, `U1_FID2`), or in pairs to the body in their middle.
    """
    names = {mark.name for mark in marks}
    bodies = [p for p in parts if p.box is not None and p.ref not in names and max(p.box.size) >= LEAST_LOCAL_BODY_MM]
    refs, found = {part.ref for part in bodies}, list(marks)
    for n, mark in enumerate(found):
        ref = next((word for word in re.split(r"[-_. ]", mark.name) if word in refs), None)
        if ref and mark.kind in ("local", "global") and not mark.components:
            found[n] = replace(mark, kind="local", components=(ref,))
    for a, b, ref in _pairs(found, bodies):
        other = sum(mark.kind == "global" for mark in found) - sum(found[n].kind == "global" for n in (a, b))
        if "global" in (found[a].kind, found[b].kind) and other < LEAST_GLOBAL:
            continue
        for n in (a, b):
            by = found[n].found_by if found[n].kind == "local" else "place"
            found[n] = replace(found[n], kind="local", found_by=by, components=(ref,))
    return found


def _pairs(marks: Sequence[Mark], bodies: Sequence[Part]) -> Iterator[tuple[int, int, str]]:
    """Yield pairs of marks beside opposite corners of one body, and its designator."""
    if len(marks) > MOST_MARKS:
        return
    usable = [n for n, mark in enumerate(marks) if mark.kind in ("global", "local") and not mark.components]
    diagonals = [(part, math.hypot(*part.box.size)) for part in bodies if part.box is not None]
    for a, b in combinations(usable, 2):
        (x0, y0), (x1, y1) = marks[a].at, marks[b].at
        middle, apart = ((x0 + x1) / 2, (y0 + y1) / 2), math.dist((x0, y0), (x1, y1))
        for part, diagonal in diagonals:
            beside = 0.7 * diagonal < apart <= diagonal + 2 * FARTHEST_LOCAL_MM
            if beside and math.dist(middle, part.center) <= CENTERED_MM:
                yield a, b, part.ref
                break
