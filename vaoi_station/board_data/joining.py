"""Join two files of one board: places from a centroid file, bodies and outline from a file of the CAD system.

Parts are matched by designator. Origins, and sometimes the direction of the axes, differ from program to program: the
shift and the rotation between both files are found from the parts that both have. So is what the angles of the
centroid file mean: the other file has pads, which prove its angles.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace
from itertools import product
from statistics import median

from vaoi_station.board_data.conversion import one_of_each
from vaoi_station.board_data.design import XY, Box, Design, Part, Placement, Side, normalised, rotated
from vaoi_station.board_data.marks import find_marks
from vaoi_station.errors import InputError
from vaoi_station.model.reason import Note

LEAST_COMMON = 3
"""With fewer parts in both files, a shift with a rotation cannot be checked."""
AGREES_MM = 0.1
"""A part whose places differ by more is a conflict; CAD systems round to 10 µm or better."""
SAME_SCALE = 2e-3
SAME_ANGLE_DEG = 0.05
_QUARTER_DEG = (0.0, 90.0, 180.0, 270.0)
_ANGLE_RULES: dict[str, Callable[[float], float]] = {
    "counter-clockwise": lambda r: r,
    "clockwise": lambda r: -r,
    "clockwise from 180°": lambda r: 180 - r,
    "counter-clockwise from 180°": lambda r: 180 + r,
}
"""What the angles of a side may mean, as seen from the top of the board; the first is that of board types."""
LEAST_SAME_PACKAGE = 2
"""As many parts of a package show that both libraries disagree about its 0°."""


def join_designs(places: Design, bodies: Design, side: Side) -> Design:
    """Return the parts of one side, placed as in `places`, with the bodies, heights, outline and marks of `bodies`.

    Raises:
        InputError: the files have too few parts in common, or do not fit each other.
    """
    for design in (places, bodies):
        if design.boards:
            raise InputError(
                f"{design.name!r} is a panel of {len(design.boards)} boards; only files of one board can be joined.",
                action="Choose the step of the board by --step, and repeat the joined board by --repeat.",
            )
    notes: list[Note] = []
    placed, placed_twice = _by_ref(places, side, notes)
    drawn, drawn_twice = _by_ref(bodies, side, notes)
    common = sorted(placed.keys() & drawn.keys())
    if len(common) < LEAST_COMMON:
        raise InputError(
            f"{places.name!r} and {bodies.name!r} have {len(common)} designators of the {side} in common, needed are "
            f"{LEAST_COMMON}; the first file has {len(placed)} parts there, the second {len(drawn)}.",
            action="Check that both are of the same board and side.",
        )
    pairs = [(placed[ref], drawn[ref]) for ref in common]
    by_center, found = _best(pairs)
    if placed_twice:
        names = _some(placed_twice)
        sentence = f"designators that occur more than once in the first file were left out: {names}."
        notes.append(Note("designators-repeated", sentence, names=names))
    if found.mirrored:
        # The board type describes both sides as seen from the top, so the places are mirrored back.
        placed, found = _unmirrored(placed, found)
        pairs = [(placed[ref], drawn[ref]) for ref in common]
        sentence = "the first file describes this side mirrored in x; its places were mirrored back."
        notes.append(Note("places-mirrored", sentence))
    errors = {b.ref: math.dist(a.origin, found.apply(_place(b, by_center))) for a, b in pairs}
    off = {ref: error for ref, error in errors.items() if error > AGREES_MM}
    good = [error for error in errors.values() if error <= AGREES_MM]
    what = "centres of bodies" if by_center else "origins"
    degrees, shift = f"{found.degrees:g}", f"{found.shift[0]:.3f}, {found.shift[1]:.3f}"
    within = f"{max(good, default=0) * 1000:.0f}"
    sentence = (
        f"joined by {len(common)} designators: the first file's places are the second's {what}, rotated by "
        f"{degrees}° and shifted by ({shift}) mm; {len(good)} agree within {within} µm."
    )
    values = {"count": len(common), "turned_deg": degrees, "shift_mm": shift, "agree": len(good), "within_um": within}
    notes.insert(0, Note("files-joined", sentence, **values))
    if 2 * len(good) < len(common):
        raise _misfit(places, bodies, pairs, len(good), found.degrees)
    angles = _angles(pairs, found.degrees, turned=all(note.code != "angles-not-stated" for note in bodies.notes))
    notes.insert(1, _note_on_angles(angles))
    joined = [_joined(a, drawn.get(a.ref), found, by_center, angles) for a in placed.values()]
    if unclear := [ref for ref in drawn_twice if ref in placed]:
        names = _some(unclear)
        sentence = f"designators that occur more than once in the second file get no body from it: {names}."
        notes.append(Note("bodies-repeated", sentence, names=names))
    notes += _conflicts(placed, drawn, off, angles, _sides(places, bodies), {*placed_twice, *drawn_twice})
    return Design(
        name=places.name,
        format=f"{places.format} + {bodies.format}",
        parts=tuple(joined),
        outline=tuple(map(found.apply, bodies.outline)),
        cut_outs=tuple(tuple(map(found.apply, contour)) for contour in bodies.cut_outs),
        # Fiducials often stand in the CAD file alone; where both files have one, the places decide.
        marks=tuple(
            replace(m, at=placed[m.name].origin if m.name in placed and m.name not in off else found.apply(m.at))
            for m in find_marks(bodies, [p for p in bodies.parts if p.side == side], side)
        ),
        table=places.table,
        step=bodies.step,
        steps=bodies.steps,
        notes=(*places.notes, *bodies.notes, *notes),
    )


def _by_ref(design: Design, side: Side, notes: list[Note]) -> tuple[dict[str, Part], list[str]]:
    """Return the parts of a side by designator, and the designators of several parts, which match nothing."""
    parts = one_of_each([part for part in design.parts if part.side == side], notes)
    counts = Counter(part.ref for part in parts)
    twice = sorted(ref for ref, count in counts.items() if count > 1)
    return {part.ref: part for part in parts if counts[part.ref] == 1}, twice


def _sides(places: Design, bodies: Design) -> dict[str, tuple[Side, Side]]:
    """Return the designators that lie on different sides in both files."""
    once = []
    for design in (places, bodies):
        counts = Counter(part.ref for part in design.parts)
        once.append({part.ref: part for part in design.parts if counts[part.ref] == 1})
    return {
        ref: (part.side, once[1][ref].side)
        for ref, part in once[0].items()
        if ref in once[1] and once[1][ref].side != part.side
    }


def _place(part: Part, by_center: bool) -> XY:
    return part.center if by_center else part.origin


def _misfit(
    places: Design, bodies: Design, pairs: Sequence[tuple[Part, Part]], good: int, degrees: float
) -> InputError:
    """Return the refusal of files that do not fit; of another scale if they fit at it."""
    for by_center in (False, True):
        spreads = []
        for points in ([a.origin for a, _ in pairs], [_place(b, by_center) for _, b in pairs]):
            middle = (median(x for x, _ in points), median(y for _, y in points))
            spreads.append(median(math.dist(p, middle) for p in points))
        factor = spreads[0] / spreads[1] if min(spreads) > 1e-6 else 1.0
        scaled = [(replace(a, origin=(a.origin[0] / factor, a.origin[1] / factor)), b) for a, b in pairs]
        if abs(factor - 1) > SAME_SCALE and 2 * _agreeing(scaled, *_best(scaled)) >= len(pairs):
            return InputError.field(
                "--join",
                "the distance of parts in the first file",
                f"{factor:.4g} times that in the second",
                "equal in both; check --units",
            )
    return InputError(
        f"{places.name!r} and {bodies.name!r} do not fit: only {good} of {len(pairs)} common parts are at the same "
        f"place (within {AGREES_MM:g} mm), at the best rotation, {degrees:g}°.",
        action="Check that both are of the same revision of the board, and that places are not those of pin 1.",
    )


def _agreeing(pairs: Sequence[tuple[Part, Part]], by_center: bool, found: Placement) -> int:
    return sum(math.dist(a.origin, found.apply(_place(b, by_center))) <= AGREES_MM for a, b in pairs)


def _best(pairs: Sequence[tuple[Part, Part]]) -> tuple[bool, Placement]:
    """Return whether places are centres of bodies, and the placement with which most parts agree."""
    turns = Counter(round((sign * a.rotation - b.rotation) % 360, 2) % 360 for a, b in pairs for sign in (1, -1))
    angles = (*_QUARTER_DEG, *(angle for angle, _ in turns.most_common(5)))
    candidates: list[tuple[int, float, int, bool, Placement]] = []
    for by_center, mirrored, degrees in product((False, True), (False, True), dict.fromkeys(angles)):
        turned = [(a.origin, Placement(mirrored, degrees, (0.0, 0.0)).apply(_place(b, by_center))) for a, b in pairs]
        shift = (median(p[0] - q[0] for p, q in turned), median(p[1] - q[1] for p, q in turned))
        errors = [math.dist(p, (q[0] + shift[0], q[1] + shift[1])) for p, q in turned]
        agreeing = sum(error <= AGREES_MM for error in errors)
        # At equal counts the simpler explanation comes first: origins, not mirrored, a quarter turn.
        total = round(sum(min(error, AGREES_MM) for error in errors), 4)
        candidates.append((-agreeing, total, len(candidates), by_center, Placement(mirrored, degrees, shift)))
    *_, by_center, found = min(candidates)
    return by_center, found


def _unmirrored(placed: dict[str, Part], found: Placement) -> tuple[dict[str, Part], Placement]:
    """Return the parts with their places mirrored in x, and the placement that then holds."""
    # (x, y) → R·(−x, y) + s, mirrored in x again, is a rotation by the negative angle and a shift with −sx.
    placement = Placement(False, normalised(-found.degrees), (-found.shift[0], found.shift[1]))
    return {ref: replace(part, origin=(-part.origin[0], part.origin[1])) for ref, part in placed.items()}, placement


@dataclass(frozen=True)
class _Angles:
    """What the angles of the first file mean."""

    rule: str
    offsets: dict[str, float]
    """Package → angle from its 0° in the first file to that in the second, where they differ."""
    fitting: frozenset[str]
    """Designators of the parts whose angle agrees with the second file."""
    own: dict[str, float]
    """Designator → angle by the second file, of the parts that do not fit and have pads."""
    turns: dict[str, float]
    """Designator → angle by the second file less that by the first, of the parts that do not fit."""
    count: int

    def rotation(self, part: Part) -> float:
        """Return the rotation of a part of the first file, counter-clockwise as seen from the top."""
        return normalised(self.own.get(part.ref, _ANGLE_RULES[self.rule](part.rotation)))


def _package(placed: Part, drawn: Part) -> str:
    return drawn.package or placed.package


def _angles(pairs: Sequence[tuple[Part, Part]], degrees: float, turned: bool) -> _Angles:
    """Return the rule and the offsets of packages by which most angles of the first file agree with the second.

    An offset must explain more than one part, since libraries that disagree about a package do so for all its parts.
    If the second file states no angles (`turned` is false), it proves none, and those of the first stay as they are.
    """
    best: tuple[int, _Angles] | None = None
    for name, rule in list(_ANGLE_RULES.items())[: None if turned else 1]:
        turns = {b.ref: (b.rotation + degrees - rule(a.rotation)) % 360 for a, b in pairs}
        quarters = {
            ref: next((quarter for quarter in _QUARTER_DEG if _is_near(turn, quarter)), None)
            for ref, turn in turns.items()
        }
        of_package: defaultdict[str, list[str]] = defaultdict(list)
        for a, b in pairs:
            of_package[_package(a, b)].append(b.ref)
        offsets, fitting = {}, set()
        for package, refs in of_package.items():
            counts = Counter(quarters[ref] for ref in refs)
            quarter = max(_QUARTER_DEG, key=lambda quarter: counts[quarter])
            if quarter and package and LEAST_SAME_PACKAGE <= counts[quarter] > len(refs) / 2:
                offsets[package] = quarter
            fitting |= {ref for ref in refs if quarters[ref] == offsets.get(package, 0.0)}
        own = {b.ref: b.rotation + degrees for _, b in pairs if turned and b.ref not in fitting and _has_pads(b)}
        others = {ref: turn for ref, turn in turns.items() if ref not in fitting}
        found = _Angles(name, offsets, frozenset(fitting), own, others, len(pairs))
        # An offset costs as much as the first part that it explains, so that it is no free choice.
        score = len(fitting) - len(offsets)
        if best is None or score > best[0]:
            best = score, found
    assert best is not None
    return best[1]


def _has_pads(part: Part) -> bool:
    """Return whether a part is of a file that states its body, and with it how it is turned."""
    return part.box is not None and part.size_from == "file"


def _note_on_angles(angles: _Angles) -> Note:
    fit, count = len(angles.fitting), angles.count
    agree = f"{fit} of {count} parts agree with the second"
    sentence = f"the first file's angles are {angles.rule}, as seen from the top: {agree}."
    return Note("angles-joined", sentence, rule=angles.rule, fit=fit, count=count)


def _is_near(degrees: float, expected: float) -> bool:
    return abs((degrees - expected + 180) % 360 - 180) <= SAME_ANGLE_DEG


def _joined(placed: Part, drawn: Part | None, found: Placement, by_center: bool, angles: _Angles) -> Part:
    """Return a part with the body of the other file."""
    placed = replace(placed, rotation=angles.rotation(placed))
    if drawn is None or drawn.box is None:
        return placed
    turn = drawn.rotation + found.degrees - placed.rotation
    box = drawn.box
    if by_center:
        (width, height) = box.size
        box = Box((-width / 2, -height / 2), (width / 2, height / 2))
    # Libraries disagree in what 0° of a package is. The body on the board is the same: its box turns in its frame.
    quarter = next((q for q in _QUARTER_DEG if _is_near(turn, q)), 0.0)
    if quarter:
        corners = [rotated(p, quarter) for p in (box.low, box.high)]
        xs, ys = zip(*corners, strict=True)
        box = Box((min(xs), min(ys)), (max(xs), max(ys)))
    # The size of a known package is better than one that is the same for all unknown packages.
    keeps = placed.box is not None and drawn.size_from == "guess" and placed.size_from != "guess"
    return replace(
        placed,
        box=placed.box if keeps else box,
        size_from=placed.size_from if keeps else drawn.size_from,
        body_height=placed.body_height if drawn.body_height is None else drawn.body_height,
        package=placed.package or drawn.package,
        value=placed.value or drawn.value,
        fitted=placed.fitted and drawn.fitted,
        is_mark=placed.is_mark or drawn.is_mark,
        mark_kind=placed.mark_kind or drawn.mark_kind,
        mark_diameter=placed.mark_diameter or drawn.mark_diameter,
    )


def _conflicts(
    placed: dict[str, Part],
    drawn: dict[str, Part],
    off: dict[str, float],
    angles: _Angles,
    sides: dict[str, tuple[Side, Side]],
    twice: Set[str],
) -> list[Note]:
    """Return a note for every kind of conflict; designators that occur twice in a file are no conflict."""
    notes = []

    def add_conflict(code: str, count: int, words: str, names: Sequence[str]) -> None:
        shown = _some(names)
        notes.append(Note(code, f"conflict: {count} parts {words}: {shown}.", count=count, names=shown))

    if off:
        worst = sorted(off, key=lambda ref: -off[ref])
        words = "are at another place in the second file; the first file's is used"
        add_conflict("places-differ", len(off), words, [f"{ref} ({off[ref]:.2f} mm)" for ref in worst])
    turned = [[f"{ref} ({normalised(-t):g}°)" for ref, t in angles.turns.items() if (ref in angles.own) is own]
              for own in (True, False)]  # fmt: skip
    if turned[0]:
        words = "have another rotation by their pads in the second file; that is used"
        add_conflict("rotations-differ", len(turned[0]), words, turned[0])
    if turned[1]:
        words = "have another rotation; the first file's is used, since the second has no pads of them"
        add_conflict("rotations-unproven", len(turned[1]), words, turned[1])
    if angles.offsets:
        names = [f"{package} ({(-offset) % 360:g}°)" for package, offset in sorted(angles.offsets.items())]
        shown = _some(names)
        sentence = f"0° of {len(names)} packages differs in both files; bodies stay as the second draws them: {shown}."
        notes.append(Note("quarter-turns-differ", sentence, count=len(names), names=shown))
    if sides:
        shown_sides = [f"{ref} ({first}, {second})" for ref, (first, second) in sides.items()]
        add_conflict("sides-differ", len(sides), "lie on different sides in both files", shown_sides)
    if missing := sorted(placed.keys() - drawn.keys() - twice):
        add_conflict("parts-without-body", len(missing), "are in the first file only, without a body", missing)
    if more := sorted(drawn.keys() - placed.keys() - twice):
        add_conflict("parts-of-second-file", len(more), "are in the second file only; they were left out", more)
    return notes


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
