"""Decide by pins how a file means the angles of its parts.

Programs differ in how they place a package: they turn it clockwise or counter-clockwise, draw it as seen from its own
side or from the top, and mirror it before or after the turn. Files that state where pins lie on the board show which of
these rules holds. It is decided for each side, and for parts with another mirror word.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from statistics import median
from typing import NamedTuple

from vaoi_station.board_data.design import XY, Box, Part, Placement, Side, body_of, normalised, noted, rotated
from vaoi_station.model.reason import Note

FITS_MM = 0.05
"""A pin fits a rule if it is nearer to its place on the board than this; files round to 10 µm or better."""
LEAST_OFFSET_MM = 0.2
"""A pin nearer to the origin of its part lies there by every rule."""
LEAST_SHARE = 0.5
"""A part fits a rule if more than this share of its pins fit: a few may be drawn elsewhere."""
LOOSE_SHARE = 0.2
"""A pin that lies beside its place by less than this share of its distance from the origin still confirms the angle."""
LEAST_CONTRAST = 0.25
"""Pins show how an outline is drawn if they extend beyond it, drawn one way, by less than this share of the other."""
LEAST_PACKAGES = 3
"""By as many packages outlines must be shown to be drawn otherwise than usual: some bodies lie beside their pins."""
LEAST_SHIFTED = 3
"""As many parts, of two packages or more, must have pins at one shift to show that pins have another datum."""
LEAST_MARGIN = 3
"""By as many pins another rule must fit better than the usual one where places may be those of other things."""
ROUNDING_MM = 0.005
"""An angle found by pins is rounded if this moves no pin by more."""


class Rule(NamedTuple):
    """How the angle of a file places a package: mirror in x or not, then turn, as seen from the top."""

    mirrored: bool
    sign: int
    """1: counter-clockwise; -1: clockwise."""
    offset: float = 0.0
    """0 or 180; with 180, mirroring in x is mirroring in y."""
    outline_mirrored: bool = False
    """Whether the outline is drawn as seen from the other side than the pins."""

    def rotation(self, degrees: float) -> float:
        """Return the rotation of the package, counter-clockwise as seen from the top."""
        return normalised(self.sign * degrees + self.offset)

    def place(self, part: Part) -> Placement:
        """Return where the package of a part lies on the board."""
        return Placement(self.mirrored, self.rotation(part.rotation), part.origin)

    def __str__(self) -> str:
        """Return the rule in words."""
        turn = f"turned {'counter-clockwise' if self.sign > 0 else 'clockwise'} by the angle"
        if self.mirrored:
            return f"mirrored in {'x' if self.offset == 0 else 'y'}, then {turn}"
        return turn if self.offset == 0 else f"{turn} and by 180°"


RULES = tuple(Rule(mirrored, sign, by) for by, mirrored, sign in product((0.0, 180.0), (False, True), (1, -1)))
Usual = Callable[[Side, str], Rule]
"""Returns the rule of the specification, or of the program that wrote the file, for a side and mirror word."""
Group = tuple[Side, str]
"""Side and mirror word of parts for which one rule holds."""


class Pin(NamedTuple):
    """A pin of a part."""

    drawn: XY | None
    """Its place in the frame of the package; None if the package has no such pin."""
    places: tuple[XY, ...]
    """Where it lies on the board; if several, at one of them."""


@dataclass(frozen=True)
class DrawnPart:
    """A part as its file states it: `part` has the angle of the file, and the body as the package draws it."""

    part: Part
    readings: tuple[tuple[Pin, ...], ...] = ((),)
    """The pins; if the file can be read in several ways, such as by number and by name, once for each."""
    word: str = ""
    """What else may change the rule, such as the mirror word of the file."""
    pads: Box | None = None
    """The box of the pins in the frame of the package."""
    pads_count: bool = False
    """Whether pins extend a body that is drawn too small, or not at all."""

    def pins(self, reading: int) -> tuple[Pin, ...]:
        """Return the pins in one reading of the file; in the last one if there are fewer."""
        return self.readings[min(reading, len(self.readings) - 1)]


@dataclass(frozen=True)
class _Decision:
    """By which rule a group of parts is placed, and what its pins show."""

    rule: Rule
    reading: int
    fitting: int
    pins: int
    rivals: int
    """Number of other rules that fit as well."""
    turned_over: int = 0
    """Number of packages that show that outlines are drawn otherwise than usual, if that is used."""
    of_others: bool = False
    """Whether the rule is that of other parts of the side, since no pin of these shows one."""

    @property
    def fits_most(self) -> bool:
        """Whether most pins fit this rule."""
        return self.fitting > LEAST_SHARE * self.pins


def placed_parts(parts: Sequence[DrawnPart], usual: Usual, *, exact: bool = True) -> tuple[list[Part], list[Note]]:
    """Return the parts with rotations and bodies as seen from the top, and what decided on them.

    Args:
        parts: the parts of a file, both sides.
        usual: the rule where pins do not decide.
        exact: whether `places` are those of pins; else they may be others, and no single part is judged by them.
    """
    groups, margin, notes = _grouped(parts), 0 if exact else LEAST_MARGIN, []
    decided = _decisions(groups, usual, margin)
    unfit_groups = {key for key, decision in decided.items() if decision.pins and not decision.fits_most}
    shift = _shift_of_pins([groups[key] for key in unfit_groups]) if exact else None
    if shift is not None:
        parts = [_shifted_back(d, shift) if (d.part.side, d.word) in unfit_groups else d for d in parts]
        groups = _grouped(parts)
        decided = _decisions(groups, usual, margin)
        text = "places of pins have another datum than those of parts; they were moved back by ({shift_mm}) mm."
        notes.append(noted("pins-of-other-datum", text, shift_mm=f"{shift[0]:z.3f}, {shift[1]:z.3f}"))
    words = Counter(side for side, _ in groups)
    for key in sorted(groups)[::-1]:
        notes.append(_note_on_rule(key, decided[key], len(groups[key]), words[key[0]] > 1))
        if count := decided[key].turned_over:
            text = (
                "pins of {count} packages on the {side} show that outlines are drawn as seen from the other side; "
                "bodies were mirrored. Check them in the picture."
            )
            notes.append(noted("outlines-by-pins", text, count=count, side=key[0]))
    found = []
    turned, unfit = [], []
    for drawn in parts:
        decision = decided[drawn.part.side, drawn.word]
        part = _placed(drawn, decision.rule)
        if exact and not _fits(drawn, decision.rule):
            own = _by_own_pins(drawn, decision)
            off_mm = 0.0 if own is None else math.dist(own.center, part.center)
            if own is not None and (own.rotation != part.rotation or off_mm > FITS_MM):
                shifted = f", body {off_mm:.2f} mm off" if off_mm > FITS_MM else ""
                turned.append(f"{part.ref} ({own.rotation:g}° instead of {part.rotation:g}°{shifted})")
                part = own
            elif own is None and not _fits(drawn, decision.rule, LOOSE_SHARE):
                unfit.append(part.ref)
        found.append(part)
    if turned:
        text = "the pins of {count} parts show another angle or place than the file states; it is used: {names}."
        notes.append(noted("angles-by-pins", text, count=len(turned), names=turned))
    if unfit:
        text = "the pins of {count} parts fit no angle of their package; check them in the picture: {names}."
        notes.append(noted("pins-unfit", text, count=len(unfit), names=unfit))
    return found, notes


def rules_of(parts: Sequence[DrawnPart], usual: Usual) -> dict[Group, Rule]:
    """Return the rule by which `placed_parts` places each group, if places may be those of other things than pins."""
    return {key: decision.rule for key, decision in _decisions(_grouped(parts), usual, LEAST_MARGIN).items()}


def _grouped(parts: Iterable[DrawnPart]) -> dict[Group, list[DrawnPart]]:
    groups: defaultdict[Group, list[DrawnPart]] = defaultdict(list)
    for drawn in parts:
        groups[drawn.part.side, drawn.word].append(drawn)
    return groups


def _shift_of_pins(groups: Iterable[Sequence[DrawnPart]]) -> XY | None:
    """Return the shift from the places of parts to those of their pins, if most parts of a group have the same one.

    Bodies beside the origins of their parts differ from package to package, and turn with the part.
    """
    found: list[tuple[int, XY]] = []
    for parts in groups:
        with_pins = sum(any(_telling(drawn.pins(0))) for drawn in parts)
        for reading, rule in product(range(max(len(drawn.readings) for drawn in parts)), RULES):
            shifts = [(shift, drawn) for drawn in parts if (shift := _shift_by(drawn, reading, rule)) is not None]
            if not shifts:
                continue
            middle = (median(x for (x, _), _ in shifts), median(y for (_, y), _ in shifts))
            same = [drawn for shift, drawn in shifts if math.dist(shift, middle) <= FITS_MM]
            packages = {tuple(pin.drawn for pin in drawn.readings[0]) for drawn in same}
            if len(same) > LEAST_SHARE * with_pins and len(same) >= LEAST_SHIFTED and len(packages) > 1:
                found.append((len(same), middle))
    return max(found, key=lambda counted: counted[0])[1] if found else None


def _shift_by(drawn: DrawnPart, reading: int, rule: Rule) -> XY | None:
    """Return how far all pins of a part lie beside their places by a rule; None if they are not shifted alike."""
    at, shifts = rule.place(drawn.part), []
    for pin in drawn.pins(reading):
        if pin.drawn is None or len(pin.places) != 1:
            return None
        (x, y), (u, v) = at.apply(pin.drawn), pin.places[0]
        shifts.append((u - x, v - y))
    middle = _mean(shifts)
    return middle if shifts and max(math.dist(shift, middle) for shift in shifts) <= FITS_MM else None


def _shifted_back(drawn: DrawnPart, shift: XY) -> DrawnPart:
    """Return a part with the places of its pins in the frame of the parts."""
    readings = tuple(
        tuple(pin._replace(places=tuple((x - shift[0], y - shift[1]) for x, y in pin.places)) for pin in reading)
        for reading in drawn.readings
    )
    return replace(drawn, readings=readings)


def _decisions(groups: Mapping[Group, Sequence[DrawnPart]], usual: Usual, margin: int) -> dict[Group, _Decision]:
    """Return what is decided for each group of parts.

    A group whose pins leave several rules takes the one that pins prove for another group of its side.
    """
    # A program that does not draw packages from their own side treats both sides alike.
    decided = {key: _decide(group, [usual(*key), usual("top", "")], margin) for key, group in groups.items()}
    proven = {key: found.rule for key, found in decided.items() if found.fits_most and not found.rivals}
    for key, group in groups.items():
        rules = {rule for other, rule in proven.items() if other[0] == key[0] and usual(*other) == usual(*key)}
        if key not in proven and len(rules) == 1:
            decision = _decide(group, [*rules, usual(*key)], margin)
            decided[key] = replace(decision, of_others=not decision.fitting)
    return decided


def _decide(parts: Sequence[DrawnPart], expected: Sequence[Rule], margin: int) -> _Decision:
    """Return the rule that fits most parts: the first expected one if no other fits more pins by a margin.

    Of other rules that fit equally well an expected one is taken.
    """
    rules = list(dict.fromkeys([*(rule._replace(outline_mirrored=False) for rule in expected), *RULES]))
    scores: dict[tuple[int, Rule], tuple[float, int, int]] = {}
    for reading in range(max(len(drawn.readings) for drawn in parts)):
        for rule in rules:
            counts = [_count(drawn, reading, rule) for drawn in parts]
            share = sum(fitting / pins for fitting, pins in counts if pins)
            scores[reading, rule] = round(share, 6), sum(n for n, _ in counts), sum(n for _, n in counts)
        if any(fitting == pins for _, fitting, pins in scores.values()):
            break
    # Of equals `max` takes the first.
    best = max(scores, key=lambda key: scores[key][:2])
    if scores[best][1] < scores[0, rules[0]][1] + margin:
        best = 0, rules[0]
    (reading, rule), (_, fitting, pins) = best, scores[best]
    rivals = sum(scores[reading, other] == scores[best] for other in rules) - 1
    turned_over = _turned_over(parts, expected[0]) if parts[0].part.side == "bottom" else 0
    rule = rule._replace(outline_mirrored=expected[0].outline_mirrored != (turned_over > 0))
    return _Decision(rule, reading, fitting, pins, rivals, turned_over)


def _telling(pins: Iterable[Pin]) -> Iterable[Pin]:
    return (pin for pin in pins if pin.drawn is None or math.hypot(*pin.drawn) >= LEAST_OFFSET_MM)


def _count(drawn: DrawnPart, reading: int, rule: Rule, loose: float = 0.0) -> tuple[int, int]:
    fitting = count = 0
    at = rule.place(drawn.part)
    for pin in _telling(drawn.pins(reading)):
        count += 1
        if pin.drawn is not None:
            most, there = max(FITS_MM, loose * math.hypot(*pin.drawn)), at.apply(pin.drawn)
            fitting += any(math.dist(there, place) <= most for place in pin.places)
    return fitting, count


def _fits(drawn: DrawnPart, rule: Rule, loose: float = 0.0) -> bool:
    counts = [_count(drawn, reading, rule, loose) for reading in range(len(drawn.readings))]
    return any(fitting > LEAST_SHARE * pins or not pins for fitting, pins in counts)


def _placed(drawn: DrawnPart, rule: Rule) -> Part:
    part, pads = drawn.part, drawn.pads
    box = part.box.mirrored() if part.box is not None and rule.mirrored != rule.outline_mirrored else part.box
    if drawn.pads_count:
        box = body_of(box, pads.mirrored() if pads is not None and rule.mirrored else pads)
    return replace(part, rotation=rule.rotation(part.rotation), box=box)


def _by_own_pins(drawn: DrawnPart, decision: _Decision) -> Part | None:
    """Return a part at the angle at which all its pins fit, if need be beside its origin; None if there is none."""
    pins = drawn.pins(decision.reading)
    known = [(pin.drawn, pin.places[0]) for pin in pins if pin.drawn is not None and len(pin.places) == 1]
    if len(known) < len(pins) or not any(math.hypot(*point) >= LEAST_OFFSET_MM for point, _ in known):
        return None
    for mirrored, shifted in product((decision.rule.mirrored, not decision.rule.mirrored), (False, True)):
        pose = _pose(known, drawn.part.origin, mirrored, shifted)
        if pose is not None:
            degrees, shift = pose
            rule = decision.rule._replace(mirrored=mirrored, sign=1, offset=0.0)
            part = _placed(replace(drawn, part=replace(drawn.part, rotation=degrees)), rule)
            if shifted and part.box is not None:
                beside = Placement(False, 0.0, rotated(shift, -degrees))
                part = replace(part, box=Box(beside.apply(part.box.low), beside.apply(part.box.high)))
            return part
    return None


def _pose(known: Sequence[tuple[XY, XY]], origin: XY, mirrored: bool, shifted: bool) -> tuple[float, XY] | None:
    """Return rotation and shift from the origin at which all pins fit, by least squares; None if they do not."""
    points = [(-x if mirrored else x, y) for (x, y), _ in known]
    places = [(x - origin[0], y - origin[1]) for _, (x, y) in known]
    (px, py), (qx, qy) = (_mean(points), _mean(places)) if shifted else ((0.0, 0.0), (0.0, 0.0))
    if shifted and max(math.dist(point, (px, py)) for point in points) < LEAST_OFFSET_MM:
        return None
    cross = dot = 0.0
    for (x, y), (u, v) in zip(points, places, strict=True):
        cross += (x - px) * (v - qy) - (y - py) * (u - qx)
        dot += (x - px) * (u - qx) + (y - py) * (v - qy)
    best = math.degrees(math.atan2(cross, dot))

    def pose_at(degrees: float) -> tuple[float, XY]:
        x, y = rotated((px, py), degrees)
        at = Placement(False, degrees, (qx - x, qy - y))
        return max(math.dist(at.apply(p), q) for p, q in zip(points, places, strict=True)), at.shift

    least, _ = pose_at(best)
    for degrees in (45 * round(best / 45), round(best), round(best, 2), best) if least <= FITS_MM else ():
        error, shift = pose_at(degrees)
        if error <= least + ROUNDING_MM:
            return normalised(degrees), shift
    return None


def _mean(points: Sequence[XY]) -> XY:
    count = max(len(points), 1)
    return sum(x for x, _ in points) / count, sum(y for _, y in points) / count


def _turned_over(parts: Sequence[DrawnPart], usual: Rule) -> int:
    """Return how many packages show that outlines are drawn from the other side than usual; 0 if too few do.

    Pins lie within the outline. Those of edge connectors do not, so a single package proves nothing.
    """
    shown: dict[tuple[Box, Box], bool] = {}
    for drawn in parts:
        body, pads = drawn.part.box, drawn.pads
        if body is None or pads is None:
            continue
        outside = [
            max(0.0, b.low[0] - pads.low[0]) + max(0.0, pads.high[0] - b.high[0]) for b in (body, body.mirrored())
        ]
        # A body may lie beside its pins: only a large difference counts.
        if max(outside) > FITS_MM and min(outside) < LEAST_CONTRAST * max(outside):
            shown[body, pads] = (outside[1] < outside[0]) != usual.outline_mirrored
    against = sum(shown.values())
    return against if against >= len(shown) - against + LEAST_PACKAGES else 0


def _note_on_rule(key: Group, decision: _Decision, count: int, name_word: bool) -> Note:
    side, word = key
    parts = f"{count} parts on the {side}" + (f" with {word!r}" if name_word else "")
    rule, fit, pins = str(decision.rule), decision.fitting, decision.pins
    values = {"count": count, "side": side, "word": word, "rule": rule, "fit": fit, "pins": pins}
    if decision.of_others:
        sentence = f"{parts} are {rule}, as the pins of other parts of this side show; their own show no rule."
        return Note("rotation-by-others", sentence, **values)
    if not fit:
        why = "states no places of pins" if not pins else f"has {pins} pins there, but none fits"
        sentence = f"{parts} are {rule}, which is usual; nothing in the file confirms it: it {why}."
        return Note("rotation-unconfirmed", sentence, **values)
    also = f"; {decision.rivals} other rules fit as well" if decision.rivals else ""
    sentence = f"{parts} are {rule}: {fit} of {pins} pins fit{also}."
    return Note("rotation-by-pins", sentence, rivals=decision.rivals, **values)
