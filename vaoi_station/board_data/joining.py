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
from vaoi_station.board_data.design import (
    Box,
    Design,
    Part,
    Placement,
    Side,
    angle_between,
    extent,
    normalised,
    noted,
    rotated,
)
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
_Pairs = Sequence[tuple[Part, Part]]
"""Parts of one designator in the first and in the second file."""


@dataclass(frozen=True)
class _Fit:
    """How the places of the first file follow from the second: of origins, or centres of bodies, by a placement."""

    by_center: bool
    placement: Placement

    def error_mm(self, placed: Part, drawn: Part) -> float:
        return math.dist(placed.origin, self.placement.apply(drawn.center if self.by_center else drawn.origin))

    def agreeing(self, pairs: _Pairs) -> int:
        return sum(self.error_mm(a, b) <= AGREES_MM for a, b in pairs)


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
    placed, placed_twice = _by_ref(one_of_each(places.parts_on(side), notes))
    drawn, drawn_twice = _by_ref(one_of_each(bodies.parts_on(side), notes))
    common = sorted(placed.keys() & drawn.keys())
    if len(common) < LEAST_COMMON:
        raise InputError(
            f"{places.name!r} and {bodies.name!r} have {len(common)} designators of the {side} in common, needed are "
            f"{LEAST_COMMON}; the first file has {len(placed)} parts there, the second {len(drawn)}.",
            action="Check that both are of the same board and side.",
        )
    pairs = [(placed[ref], drawn[ref]) for ref in common]
    fit = _best(pairs)
    if placed_twice:
        text = "designators that occur more than once in the first file were left out: {names}."
        notes.append(noted("designators-repeated", text, names=placed_twice))
    if fit.placement.mirrored:
        # The board type describes both sides as seen from the top, so the places are mirrored back:
        # (x, y) → R·(−x, y) + s, mirrored in x again, is a rotation by the negative angle and a shift with −sx.
        degrees, (x, y) = fit.placement.degrees, fit.placement.shift
        fit = replace(fit, placement=Placement(False, normalised(-degrees), (-x, y)))
        placed = {ref: replace(part, origin=(-part.origin[0], part.origin[1])) for ref, part in placed.items()}
        pairs = [(placed[ref], drawn[ref]) for ref in common]
        text = "the first file describes this side mirrored in x; its places were mirrored back."
        notes.append(noted("places-mirrored", text))
    errors = {b.ref: fit.error_mm(a, b) for a, b in pairs}
    off = {ref: error for ref, error in errors.items() if error > AGREES_MM}
    good = [error for error in errors.values() if error <= AGREES_MM]
    if 2 * len(good) < len(common):
        raise _misfit(places, bodies, pairs, len(good), fit.placement.degrees)
    placement, what = fit.placement, "centres of bodies" if fit.by_center else "origins"
    text = (
        f"joined by {{count}} designators: the first file's places are the second's {what}, rotated by {{turned_deg}}° "
        "and shifted by ({shift_mm}) mm; {agree} agree within {within_um} µm."
    )
    values = {"count": len(common), "agree": len(good), "within_um": f"{max(good, default=0) * 1000:.0f}"}
    shift = "{:.3f}, {:.3f}".format(*placement.shift)
    joined = noted("files-joined", text, turned_deg=f"{placement.degrees:g}", shift_mm=shift, **values)
    proven = all(note.code != "angles-not-stated" for note in bodies.notes)
    angles = _angles(pairs, placement.degrees, turned=proven)
    text = "the first file's angles are {rule}, as seen from the top: {fit} of {count} parts agree with the second."
    notes[:0] = [joined, noted("angles-joined", text, rule=angles.rule, fit=angles.fitting, count=len(common))]
    if unclear := [ref for ref in drawn_twice if ref in placed]:
        text = "designators that occur more than once in the second file get no body from it: {names}."
        notes.append(noted("bodies-repeated", text, names=unclear))
    notes += _conflicts(placed, drawn, off, angles, _sides(places, bodies), {*placed_twice, *drawn_twice})
    marks = (
        replace(m, at=placed[m.name].origin if m.name in placed and m.name not in off else placement.apply(m.at))
        for m in find_marks(bodies, side)
    )
    return Design(
        name=places.name,
        format=f"{places.format} + {bodies.format}",
        parts=tuple(_joined(a, drawn.get(a.ref), fit, angles) for a in placed.values()),
        outline=tuple(map(placement.apply, bodies.outline)),
        cut_outs=tuple(tuple(map(placement.apply, contour)) for contour in bodies.cut_outs),
        # Fiducials often stand in the CAD file alone; where both files have one, the places decide.
        marks=tuple(marks),
        net_points=tuple(p._replace(at=placement.apply(p.at)) for p in bodies.net_points),
        table=places.table,
        step=bodies.step,
        steps=bodies.steps,
        notes=(*places.notes, *bodies.notes, *notes),
    )


def _by_ref(parts: Sequence[Part]) -> tuple[dict[str, Part], list[str]]:
    """Return the parts by designator, and the designators of several parts, which match nothing."""
    counts = Counter(part.ref for part in parts)
    once = {part.ref: part for part in parts if counts[part.ref] == 1}
    return once, sorted(ref for ref, count in counts.items() if count > 1)


def _sides(places: Design, bodies: Design) -> list[str]:
    """Return the designators that lie on different sides in both files, with these sides."""
    first, second = (_by_ref(design.parts)[0] for design in (places, bodies))
    both = [(part, second[ref]) for ref, part in first.items() if ref in second]
    return [f"{a.ref} ({a.side}, {b.side})" for a, b in both if a.side != b.side]


def _misfit(places: Design, bodies: Design, pairs: _Pairs, good: int, degrees: float) -> InputError:
    """Return the refusal of files that do not fit; of another scale if they fit at it."""
    for by_center in (False, True):
        spreads = []
        for points in ([a.origin for a, _ in pairs], [b.center if by_center else b.origin for _, b in pairs]):
            middle = (median(x for x, _ in points), median(y for _, y in points))
            spreads.append(median(math.dist(p, middle) for p in points))
        factor = spreads[0] / spreads[1] if min(spreads) > 1e-6 else 1.0
        scaled = [(replace(a, origin=(a.origin[0] / factor, a.origin[1] / factor)), b) for a, b in pairs]
        if abs(factor - 1) > SAME_SCALE and 2 * _best(scaled).agreeing(scaled) >= len(pairs):
            value, limit = f"{factor:.4g} times that in the second", "equal in both; check --units"
            return InputError.field("--join", "the distance of parts in the first file", value, limit)
    return InputError(
        f"{places.name!r} and {bodies.name!r} do not fit: only {good} of {len(pairs)} common parts are at the same "
        f"place (within {AGREES_MM:g} mm), at the best rotation, {degrees:g}°.",
        action="Check that both are of the same revision of the board, and that places are not those of pin 1.",
    )


def _best(pairs: _Pairs) -> _Fit:
    """Return whether places are centres of bodies, and the placement with which most parts agree."""
    turns = Counter(round((sign * a.rotation - b.rotation) % 360, 2) % 360 for a, b in pairs for sign in (1, -1))
    angles = (*_QUARTER_DEG, *(angle for angle, _ in turns.most_common(5)))
    candidates: list[tuple[int, float, int, _Fit]] = []
    for by_center, mirrored, degrees in product((False, True), (False, True), dict.fromkeys(angles)):
        turn = Placement(mirrored, degrees)
        turned = [(a.origin, turn.apply(b.center if by_center else b.origin)) for a, b in pairs]
        shift = (median(p[0] - q[0] for p, q in turned), median(p[1] - q[1] for p, q in turned))
        errors = [math.dist(p, (q[0] + shift[0], q[1] + shift[1])) for p, q in turned]
        agreeing = sum(error <= AGREES_MM for error in errors)
        # At equal counts the simpler explanation comes first: origins, not mirrored, a quarter turn.
        total = round(sum(min(error, AGREES_MM) for error in errors), 4)
        fit = _Fit(by_center, Placement(mirrored, degrees, shift))
        candidates.append((-agreeing, total, len(candidates), fit))
    return min(candidates)[-1]


@dataclass(frozen=True)
class _Angles:
    """What the angles of the first file mean."""

    rule: str
    offsets: dict[str, float]
    """Package → angle from its 0° in the first file to that in the second, where they differ."""
    fitting: int
    """Number of parts whose angle agrees with the second file."""
    own: dict[str, float]
    """Designator → angle by the second file, of the parts that do not fit and have pads."""
    turns: dict[str, float]
    """Designator → angle by the second file less that by the first, of the parts that do not fit."""


def _angles(pairs: _Pairs, degrees: float, turned: bool) -> _Angles:
    """Return the rule and the offsets of packages by which most angles of the first file agree with the second.

    An offset must explain more than one part, since libraries that disagree about a package do so for all its parts.
    If the second file states no angles (`turned` is false), it proves none, and those of the first stay as they are.
    """
    of_package: defaultdict[str, list[str]] = defaultdict(list)
    for a, b in pairs:
        of_package[b.package or a.package].append(b.ref)
    found: list[tuple[int, _Angles]] = []
    for name, rule in list(_ANGLE_RULES.items())[: None if turned else 1]:
        turns = {b.ref: (b.rotation + degrees - rule(a.rotation)) % 360 for a, b in pairs}
        quarters = {ref: _quarter(turn) for ref, turn in turns.items()}
        offsets, fitting = {}, set()
        for package, refs in of_package.items():
            counts = Counter(quarters[ref] for ref in refs)
            quarter = max(_QUARTER_DEG, key=lambda quarter: counts[quarter])
            if quarter and package and LEAST_SAME_PACKAGE <= counts[quarter] > len(refs) / 2:
                offsets[package] = quarter
            fitting |= {ref for ref in refs if quarters[ref] == offsets.get(package, 0.0)}
        others = {ref: turn for ref, turn in turns.items() if ref not in fitting}
        has_pads = {b.ref: b.rotation + degrees for _, b in pairs if b.box is not None and b.size_from == "file"}
        own = {ref: angle for ref, angle in has_pads.items() if turned and ref in others}
        # An offset costs as much as the first part that it explains, so that it is no free choice.
        found.append((len(fitting) - len(offsets), _Angles(name, offsets, len(fitting), own, others)))
    return max(found, key=lambda scored: scored[0])[1]


def _quarter(turn: float) -> float | None:
    """Return the quarter turn that an angle is, if it is one."""
    return next((quarter for quarter in _QUARTER_DEG if angle_between(turn, quarter) <= SAME_ANGLE_DEG), None)


def _joined(placed: Part, drawn: Part | None, fit: _Fit, angles: _Angles) -> Part:
    rotation = normalised(angles.own.get(placed.ref, _ANGLE_RULES[angles.rule](placed.rotation)))
    placed = replace(placed, rotation=rotation)
    if drawn is None or drawn.box is None:
        return placed
    box = Box.of_size(*drawn.box.size) if fit.by_center else drawn.box
    # Libraries disagree in what 0° of a package is. The body on the board is the same: its box turns in its frame.
    if quarter := _quarter(drawn.rotation + fit.placement.degrees - rotation):
        box = Box(*extent(rotated(p, quarter) for p in (box.low, box.high)))
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
    sides: list[str],
    twice: Set[str],
) -> list[Note]:
    notes = []

    def add_conflict(code: str, words: str, names: list[str]) -> None:
        if names:
            notes.append(noted(code, f"conflict: {{count}} parts {words}: {{names}}.", count=len(names), names=names))

    worst = [f"{ref} ({off[ref]:.2f} mm)" for ref in sorted(off, key=lambda ref: -off[ref])]
    add_conflict("places-differ", "are at another place in the second file; the first file's is used", worst)
    by_pads, unproven = (
        [f"{ref} ({normalised(-t):g}°)" for ref, t in angles.turns.items() if (ref in angles.own) is own]
        for own in (True, False)
    )
    add_conflict("rotations-differ", "have another rotation by their pads in the second file; that is used", by_pads)
    words = "have another rotation; the first file's is used, since the second has no pads of them"
    add_conflict("rotations-unproven", words, unproven)
    if angles.offsets:
        names = [f"{package} ({(-offset) % 360:g}°)" for package, offset in sorted(angles.offsets.items())]
        text = "0° of {count} packages differs in both files; bodies stay as the second draws them: {names}."
        notes.append(noted("quarter-turns-differ", text, count=len(names), names=names))
    add_conflict("sides-differ", "lie on different sides in both files", sides)
    missing, more = sorted(placed.keys() - drawn.keys() - twice), sorted(drawn.keys() - placed.keys() - twice)
    add_conflict("parts-without-body", "are in the first file only, without a body", missing)
    add_conflict("parts-of-second-file", "are in the second file only; they were left out", more)
    return notes
