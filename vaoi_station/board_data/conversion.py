"""Make a board type of one side of a design."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence

from vaoi_station.board_data.design import XY, Design, Part, Side
from vaoi_station.board_data.package_sizes import GUESS_MM
from vaoi_station.errors import InputError
from vaoi_station.geometry.polygon import find_crossing_edges
from vaoi_station.model import BoardType
from vaoi_station.model.board_type import Component, Fiducial

SAME_PLACE_MM = 1e-3
"""A body whose centre is nearer to the origin of its part than this is at it."""
USUAL_MARK_MM = 1.0
"""Diameter of a fiducial of which the file states none: IPC-7351 recommends 1 mm."""
_MARK_NAME = re.compile(r"^(FID|FD|FM|MARK|FIDUCIAL)[-_ ]?\d*$", re.IGNORECASE)
_MARK_PACKAGE = re.compile(r"fid(ucial)?([^a-z]|$)|fiducial", re.IGNORECASE)
_MARK_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*mm", re.IGNORECASE)
MOST_OUTLINE_POINTS = 2_000


def to_board_type(design: Design, side: Side, name: str | None = None) -> tuple[BoardType, tuple[str, ...]]:
    """Return the board type of one side, in mm with y up, and sentences on what the user should check."""
    chosen = [part for part in design.parts if part.side == side]
    if not chosen:
        others = Counter(part.side for part in design.parts)
        found = ", ".join(f"{count} on the {s}" for s, count in others.items()) or "none at all"
        raise InputError(
            f"design {design.name!r} has no part on the {side}; parts: {found}. Choose the side by --side."
        )
    counts = Counter(part.ref for part in chosen)
    repeated = sorted(ref for ref, count in counts.items() if count > 1)
    parts = [part for part in chosen if counts[part.ref] == 1 and part.box is not None]
    notes = list(design.notes)
    if repeated:
        notes.append(f"designators that occur more than once were left out: {_some(repeated)}.")
    if guessed := [part.ref for part in parts if part.size_from == "guess"]:
        width, height = GUESS_MM
        notes.append(
            f"{len(guessed)} parts have no size in the file, and their package is in no table: {width:g} × {height:g} "
            f"mm is a guess for {_some(guessed)}. Give sizes by --sizes FILE."
        )
    fiducials = list(_fiducials(design, parts, side, notes))
    if len(fiducials) < 2:
        notes.append(
            f"{len(fiducials)} fiducials found on the {side}; two are needed to stitch. Add them to the board type."
        )
    outline = _outline(design, parts, fiducials, notes)
    board = BoardType(
        name=name or design.name,
        side=side,
        outline=outline,
        fiducials=tuple(fiducials),
        components=tuple(_component(part) for part in parts),
    )
    return board, tuple(notes)


def _component(part: Part) -> Component:
    assert part.box is not None
    width, height = part.box.size
    return Component(
        ref=part.ref,
        center=_rounded(part.center),
        width=round(max(width, 0.05), 4),
        height=round(max(height, 0.05), 4),
        rotation=part.rotation,
        body_height=part.body_height and round(part.body_height, 4),
        origin=_rounded(part.origin) if math.dist(part.center, part.origin) > SAME_PLACE_MM else None,
        package=part.package or None,
        size_from=part.size_from,
        fitted=None if part.fitted else False,
    )


def _fiducials(design: Design, parts: Sequence[Part], side: Side, notes: list[str]) -> Iterator[Fiducial]:
    """Yield the fiducials of a side: explicit ones of the file, else parts whose name or package says so."""
    explicit = [mark for mark in design.marks if mark[1] in (side, None)]
    found: list[tuple[str, XY, float | None]] = [(name, at, diameter) for name, _, at, diameter in explicit]
    how = "explicit elements of the file"
    if not found:
        by_file = [part for part in parts if part.is_mark]
        marks = by_file or [p for p in parts if _MARK_NAME.match(p.ref) or _MARK_PACKAGE.search(p.package)]
        how = "package or attribute" if by_file else "name"
        found = [(part.ref, part.origin, part.mark_diameter or _diameter_in(part.package)) for part in marks]
    if not found:
        return
    unknown = [name for name, _, diameter in found if not diameter]
    notes.append(f"{len(found)} fiducials by {how}: {_some([name for name, _, _ in found])}.")
    if unknown:
        notes.append(f"the file states no diameter of {_some(unknown)}; {USUAL_MARK_MM:g} mm is assumed.")
    taken: list[XY] = []
    for name, at, diameter in found:
        if any(math.dist(at, other) < 0.1 for other in taken):
            notes.append(f"fiducial {name!r} is at the place of another one; it was left out.")
            continue
        taken.append(at)
        x, y = _rounded(at)
        yield Fiducial(name=name, x=x, y=y, diameter=round(diameter or USUAL_MARK_MM, 4))


def _diameter_in(package: str) -> float | None:
    """Return the diameter in a name such as `Fiducial_0.75mm_Mask1.5mm`."""
    found = _MARK_SIZE.search(package)
    return float(found[1]) if found and 0.05 <= float(found[1]) <= 50 else None


def _outline(
    design: Design, parts: Sequence[Part], fiducials: Sequence[Fiducial], notes: list[str]
) -> tuple[XY, ...] | None:
    corners = [_rounded(p) for p in design.outline]
    corners = [p for n, p in enumerate(corners) if p != corners[n - 1]]
    if not corners:
        notes.append("the file has no outline; the extent of parts and fiducials is used.")
        return None
    xs, ys = zip(*corners, strict=True)
    rectangle = ((min(xs), min(ys)), (max(xs), max(ys)))
    inside = all(min(xs) <= f.x <= max(xs) and min(ys) <= f.y <= max(ys) for f in fiducials)
    if not inside:
        notes.append("fiducials lie outside the outline; it was left out. Check that both are of the same board.")
        return None
    stray = [p.ref for p in parts if not (min(xs) <= p.center[0] <= max(xs) and min(ys) <= p.center[1] <= max(ys))]
    if stray:
        notes.append(f"{len(stray)} parts lie outside the outline: {_some(stray)}.")
    if len(corners) > MOST_OUTLINE_POINTS or len(corners) < 3 or find_crossing_edges(corners):
        notes.append("the outline crosses itself or has too many corners; its bounding rectangle is used.")
        return rectangle
    return tuple(corners)


def _rounded(point: XY) -> XY:
    """Return a point in steps of 0.1 µm."""
    return round(point[0], 4), round(point[1], 4)


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
