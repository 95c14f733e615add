"""Make a board type of one side of a design."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Sequence

from pydantic import ValidationError

from vaoi_station.board_data.contours import area
from vaoi_station.board_data.design import (
    XY,
    Contour,
    Design,
    Mark,
    Part,
    Side,
    angle_between,
    extent,
    noted,
    places,
    some,
)
from vaoi_station.board_data.frame import parts_within
from vaoi_station.board_data.marks import find_marks
from vaoi_station.board_data.package_sizes import GUESS_MM
from vaoi_station.errors import InputError
from vaoi_station.geometry.polygon import encloses, find_crossing_edges
from vaoi_station.model import BoardType
from vaoi_station.model.board_type import (
    MOST_CUT_OUT_CORNERS,
    MOST_POINTS,
    Component,
    Fiducial,
    OtherMark,
    PointTable,
    fiducials_by_board,
)
from vaoi_station.model.reason import Note

SAME_PLACE_MM = 1e-3
"""A body whose centre is nearer to the origin of its part than this is at it."""
SAME_PART_MM, SAME_PART_DEG = 0.01, 0.1
"""Two parts of one designator and package that are nearer to each other are one, drawn twice."""
USUAL_MARK_MM = 1.0
"""Diameter of a fiducial of which the file states none: IPC-7351 recommends 1 mm."""
LEAST_MARK_MM, MOST_MARK_MM = 0.05, 50.0
"""A mark of another diameter is not possible in a board type; its diameter counts as not stated."""
MOST_OUTLINE_POINTS = 2_000
MOST_CUT_OUTS = 200
"""Largest number of cut-outs that are kept, the largest first; drill holes that are drawn as contours exceed it."""


def to_board_type(design: Design, side: Side, name: str | None = None) -> tuple[BoardType, tuple[Note, ...]]:
    """Return the board type of one side, in mm with y up, and sentences on what the user should check.

    Raises:
        InputError: the side has no part, or the design exceeds a limit of board types.
    """
    chosen = design.parts_on(side)
    if not chosen:
        others = Counter(part.side for part in design.parts)
        found = ", ".join(f"{count} on the {s}" for s, count in others.items()) or "none at all"
        advice = _advice(design, side)
        raise InputError(f"design {design.name!r} has no part on the {side}; parts: {found}.", action=advice)
    notes = list(design.notes)
    parts = _once_each(design, chosen, side, notes)
    if guessed := [part.address for part in parts if part.size_from == "guess"]:
        text = (
            "{count} parts have no size in the file, and their package is in no table: {size} mm is a guess for "
            "{names}. Give sizes by --sizes FILE."
        )
        size = "{:g} × {:g}".format(*GUESS_MM)
        notes.append(noted("sizes-guessed", text, count=len(guessed), size=size, names=guessed))
    try:
        fiducials, other_marks = _marks_of(design, side, notes)
        outline = _outline(design, parts, fiducials, notes)
        board = BoardType(
            name=name or design.name,
            side=side,
            outline=outline,
            cut_outs=_without_boards(_cut_outs(design, outline, notes), parts, notes) or None,
            fiducials=tuple(fiducials),
            other_marks=tuple(other_marks) or None,
            components=tuple(map(_component, parts)),
            test_points=_test_points(design, side, notes),
        )
    except ValidationError as error:
        faults = "; ".join(str(fault["msg"]) for fault in error.errors()[:3])
        raise InputError(f"design {design.name!r} makes no board type: {faults}.") from error
    return board, tuple(notes)


def _test_points(design: Design, side: Side, notes: list[Note]) -> PointTable | None:
    points = [point for point in design.net_points if point.on_side(side)]
    if len(points) > MOST_POINTS:
        text = "the side has {count} test points, more than {most}; they were left out."
        notes.append(noted("net-points-left-out", text, count=len(points), most=MOST_POINTS))
    if not 0 < len(points) <= MOST_POINTS:
        return None
    x, y = zip(*(_rounded(p.at) for p in points), strict=True)
    return PointTable(
        name=tuple(p.name for p in points),
        x=x,
        y=y,
        net=tuple(p.net for p in points),
        kind=tuple(p.kind for p in points),
        diameter=tuple((p.diameter and round(p.diameter, 4)) or None for p in points),
    )


def _advice(design: Design, side: Side) -> str:
    if not design.parts:
        return "Export the file with its components."
    table = design.table
    if table is not None and table.all_on is None and not table.has("side"):
        return f"If the parts of the file are those of the {side}, state it by --columns side={side}."
    return "Choose the side by --side."


def _once_each(design: Design, chosen: Sequence[Part], side: Side, notes: list[Note]) -> list[Part]:
    """Return the parts with a body whose designator occurs once; refuse a panel that tells no board from another."""
    single = one_of_each(chosen, notes)
    counts = Counter(part.address for part in single)
    repeated = sorted(address for address, count in counts.items() if count > 1)
    parts = [part for part in single if counts[part.address] == 1 and part.box is not None]
    if repeated:
        names = some([*(address + _lines(address, chosen) for address in repeated[:8]), *repeated[8:]])
        text = "designators that occur more than once were left out: {names}."
        notes.append(noted("designators-repeated", text, names=names))
    if 2 * len(repeated) > len(counts):
        panel = (
            f"{len(repeated)} of {len(counts)} designators of the {side} occur more than once: the file seems to be of "
            "a panel that does not state which part is of which board."
        )
        action = "Import the file of one board, and state its panel by --repeat and --pitch."
        if not parts:
            raise InputError(f"design {design.name!r}: {panel}", action=action)
        notes.append(Note("panel-unresolved", f"{panel} {action}", count=len(repeated), all=len(counts)))
    return parts


def one_of_each(parts: Sequence[Part], notes: list[Note]) -> list[Part]:
    """Return the parts without those that stand beside the fitted one, or twice at its place, under one designator.

    Alternatives of which one is fitted are drawn as several parts. All parts of other repeated designators remain.
    """
    by_address: defaultdict[str, list[Part]] = defaultdict(list)
    for part in parts:
        by_address[part.address].append(part)
    found, doubled, alternatives = [], [], []
    for address, same in by_address.items():
        distinct = [part for n, part in enumerate(same) if not any(_is_copy(part, other) for other in same[:n])]
        fitted = [part for part in distinct if part.fitted]
        listed = [part for part in fitted if part.in_bom]
        kept = next((group for group in (fitted, listed) if len(group) == 1), distinct)
        found += kept
        if len(distinct) < len(same) and len(kept) == 1:
            doubled.append(address + _lines(address, parts))
        if len(kept) < len(distinct):
            alternatives.append(f"{address} at {places([kept[0].origin])}")
    if doubled:
        notes.append(noted("parts-doubled", "parts that stand twice at one place count once: {names}.", names=doubled))
    if alternatives:
        text = "of parts with one designator, the only one that is fitted was taken: {names}."
        notes.append(noted("parts-alternative", text, names=alternatives))
    return found


def _is_copy(part: Part, other: Part) -> bool:
    same = (part.package, part.fitted, part.in_bom) == (other.package, other.fitted, other.in_bom)
    turn = angle_between(part.rotation, other.rotation)
    return same and math.dist(part.origin, other.origin) <= SAME_PART_MM and turn <= SAME_PART_DEG


def _lines(address: str, parts: Sequence[Part]) -> str:
    lines = [str(part.line) for part in parts if part.address == address and part.line is not None]
    return f" (lines {some(lines)})" if lines else ""


def _component(part: Part) -> Component:
    assert part.box is not None
    width, height = part.box.size
    return Component(
        ref=part.ref,
        panel=part.panel,
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


def _marks_of(design: Design, side: Side, notes: list[Note]) -> tuple[list[Fiducial], list[OtherMark]]:
    found = find_marks(design, side)
    by_kind: defaultdict[tuple[str, str], list[Mark]] = defaultdict(list)
    for mark in found:
        by_kind[mark.kind, mark.found_by].append(mark)
    for (kind, by), marks in by_kind.items():
        names = some([m.name + (f" (of {', '.join(m.components)})" if m.components else "") for m in marks])
        noun = "bad-board marks" if kind == "bad-board" else f"{kind} fiducials"
        sentence = f"{len(marks)} {noun} by {'elements of the file' if by == 'element' else by}: {names}."
        notes.append(Note("marks-found", sentence, count=len(marks), kind=kind, by=by, names=names))
    if unknown := [mark.name for mark in found if _stated_mm(mark) is None]:
        text = "the file states no diameter of {names}; {diameter_mm} mm is assumed."
        notes.append(noted("mark-diameters-assumed", text, names=unknown, diameter_mm=f"{USUAL_MARK_MM:g}"))
    fiducials, others = list[Fiducial](), list[OtherMark]()
    counts: Counter[str] = Counter()
    for mark in found:
        counts[mark.name] += 1
        name = mark.name if counts[mark.name] == 1 else f"{mark.name}-{counts[mark.name]}"
        (x, y), diameter = _rounded(mark.at), round(_stated_mm(mark) or USUAL_MARK_MM, 4)
        by_what, panel, of = mark.found_by, mark.panel, mark.components or None
        if mark.kind in ("panel", "bad-board"):
            other = OtherMark(name=name, x=x, y=y, diameter=diameter, kind=mark.kind, found_by=by_what, panel=panel)
            others.append(other)
        else:
            fiducials.append(
                Fiducial(
                    name=name, x=x, y=y, diameter=diameter, kind=mark.kind, found_by=by_what, components=of, panel=panel
                )
            )
    if alone := [position for position, numbers in fiducials_by_board(fiducials).items() if len(numbers) == 1]:
        text = (
            "one fiducial alone places {count} boards of the panel, so that runs are degraded: positions {names}. Give "
            "each a second one, or remove the `panel` of their fiducials."
        )
        notes.append(noted("boards-of-one-fiducial", text, count=len(alone), names=alone))
    if len(fiducials) < 2:
        text = f"{{count}} fiducials found on the {side}; two are needed to stitch. Add them to the board type."
        notes.append(noted("fiducials-few", text, count=len(fiducials)))
    return fiducials, others


def _stated_mm(mark: Mark) -> float | None:
    """Return the diameter that the file states, if it is one of a mark."""
    return mark.diameter if mark.diameter and LEAST_MARK_MM <= mark.diameter <= MOST_MARK_MM else None


def _outline(design: Design, parts: Sequence[Part], fiducials: Sequence[Fiducial], notes: list[Note]) -> Contour | None:
    corners = _distinct(design.outline)
    if not corners:
        # The file of a board that is repeated may have an outline, but of the board only.
        if not any(note.code == "panel-edges-unknown" for note in notes):
            notes.append(noted("outline-absent", "the file has no outline; the extent of parts and fiducials is used."))
        return None
    (left, low), (right, high) = rectangle = extent(corners)
    if not all(left <= f.x <= right and low <= f.y <= high for f in fiducials):
        text = "fiducials lie outside the outline; it was left out. Check that both are of the same board."
        notes.append(noted("outline-elsewhere", text))
        return None
    stray = [p.address for p in parts if not (left <= p.center[0] <= right and low <= p.center[1] <= high)]
    if stray:
        text = "{count} parts lie outside the outline: {names}."
        notes.append(noted("parts-outside", text, count=len(stray), names=stray))
    if len(corners) > MOST_OUTLINE_POINTS or len(corners) < 3 or find_crossing_edges(corners):
        text = "the outline crosses itself or has too many corners; its bounding rectangle is used."
        notes.append(noted("outline-unusable", text))
        return rectangle
    return corners


def _cut_outs(design: Design, outline: Contour | None, notes: list[Note]) -> tuple[Contour, ...]:
    """Return the cut-outs within the outline; other contours are of no use for one board."""
    found: list[Contour] = []
    count, left_out = 0, []
    for contour in sorted(design.cut_outs, key=lambda c: -abs(area(c))) if outline is not None else ():
        corners = _distinct(contour)
        fits = len(found) < MOST_CUT_OUTS and count + len(corners) <= MOST_CUT_OUT_CORNERS
        usable = fits and 3 <= len(corners) <= MOST_OUTLINE_POINTS and not find_crossing_edges(corners)
        if usable and outline and _within(outline, corners):
            found.append(corners)
            count += len(corners)
        else:
            left_out.append(min(corners, default=(0.0, 0.0)))
    if left_out:
        text = (
            "{count} contours lie outside the outline or cannot be used as cut-outs; they were left out: from {at} on. "
            "Check whether the file is of a panel."
        )
        notes.append(noted("contours-left-out", text, count=len(left_out), at=places(left_out)))
    return tuple(found)


def _within(outline: Contour, corners: Contour) -> bool:
    """Return whether a contour lies inside an outline: all corners in its extent, two of them inside its polygon."""
    # The distance from the polygon is tested for few corners only, since it takes long for many contours.
    (left, low), (right, high) = extent(outline)
    inside = all(left <= x <= right and low <= y <= high for x, y in corners)
    return inside and all(encloses(outline, p) for p in (corners[0], corners[len(corners) // 2]))


def _without_boards(cut_outs: tuple[Contour, ...], parts: Sequence[Part], notes: list[Note]) -> tuple[Contour, ...]:
    """Return the cut-outs without those that hold parts if most parts lie in one; else parts in a cut-out are named.

    A single part may lie over a cut-out, such as an optocoupler over its slot.
    """
    held = parts_within(cut_outs, parts)
    inside = [part.address for of in held for part in of]
    boards = [contour for contour, of in zip(cut_outs, held, strict=True) if of]
    if 2 * len(inside) > len(parts):
        text = (
            "{count} of {all} parts lie within {contours} contours inside the outline, from {at} on: they seem to be "
            "boards of a panel, and are no cut-outs. If one board is filmed, import the file of it."
        )
        values = {"count": len(inside), "all": len(parts), "contours": len(boards), "at": places(map(min, boards))}
        notes.append(noted("boards-in-outline", text, **values))
        return tuple(contour for contour in cut_outs if contour not in boards)
    if inside:
        text = "{count} parts have their centre in a cut-out: {names}. Check the cut-outs in the picture."
        notes.append(noted("parts-in-cut-outs", text, count=len(inside), names=inside))
    return cut_outs


def _distinct(contour: Sequence[XY]) -> Contour:
    corners = [_rounded(p) for p in contour]
    return tuple(p for n, p in enumerate(corners) if p != corners[n - 1])


def _rounded(point: XY) -> XY:
    """Return a point in steps of 0.1 µm."""
    return round(point[0], 4), round(point[1], 4)
