"""Read GenCAD 1.4 files.

Shapes are drawn as seen from their own side. A component on the bottom names its shape with MIRRORX and FLIP, with
FLIP alone (EasyEDA), or with MIRRORY. Rotations are counter-clockwise as seen from the top. No section states where
pins lie; but tracks of their signal end on them, which shows what the words mean (`pin_rules`). Source: GenCAD
specification 1.4, Mitron 1997; files of KiCad and EasyEDA.
"""

from __future__ import annotations

import math
import shlex
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vaoi_station.board_data.contours import arc_points, circle_points, find_contours
from vaoi_station.board_data.design import (
    XY,
    Box,
    Design,
    NetPoint,
    Part,
    Placement,
    PointKind,
    Side,
    box_around,
    normalised,
    noted,
)
from vaoi_station.board_data.net_points import Openings, numbered, vias_without_mask
from vaoi_station.board_data.pin_rules import FITS_MM, DrawnPart, Pin, Rule, placed_parts, rules_of
from vaoi_station.board_data.source_text import decode, number_of
from vaoi_station.errors import InputError

_UNITS = {"INCH": 25.4, "THOU": 0.0254, "MM": 1.0, "MM100": 0.01}
_SECTIONS = frozenset(("HEADER", "BOARD", "PADS", "PADSTACKS", "SHAPES", "COMPONENTS", "SIGNALS", "ROUTES", "TESTPINS"))
_NOWHERE = -32767
"""Coordinates of a test pin that has no place, in the unit of the file."""
LEAST_UNITS = 1e-3
"""Smallest n of `USER n`: a unit of 25 m."""


class _Line(NamedTuple):
    number: int
    words: list[str]

    def word(self, n: int) -> str:
        """Return a word; an empty one behind the last."""
        return self.words[n] if n < len(self.words) else ""


class _ShapePin(NamedTuple):
    name: str
    stack: str
    at: XY
    layer: str
    """Of a pin that names a pad instead of a stack: TOP or BOTTOM; such a pin has a line for each."""
    degrees: float


@dataclass
class _Shape:
    drawing: list[list[XY]] = field(default_factory=list)
    pins: list[_ShapePin] = field(default_factory=list)
    height: float | None = None


def is_gencad(head: bytes) -> bool:
    """Return whether a file begins like a GenCAD file."""
    return b"$HEADER" in head and b"GENCAD" in head


def read_gencad(data: bytes, path: Path) -> Design:
    """Read a GenCAD file."""
    sections = _sections(decode(data, path), path)
    mm, name = 1.0, path.stem
    for line in sections["HEADER"]:
        if line.word(0) == "UNITS":
            mm = _unit(line, path)
        elif line.word(0) == "DRAWING" and len(line.words) > 1:
            name = line.word(1).removesuffix(".kicad_pcb")
    reader = _Reader(path, mm, sections)
    contours = find_contours(reader.edges(sections["BOARD"]), "$BOARD")
    drawn, shapes, unknown = [], [], set()
    for component in _components(sections["COMPONENTS"]):
        if "PLACE" in component:
            drawn.append(reader.part(component))
            shapes.append(component.get("SHAPE", _Line(0, [])).word(1))
        else:
            unknown.add(component["COMPONENT"].word(1))
    # Tracks have corners where other pins would be, so that they show the rule of a side, but not the angle of a part.
    parts, notes = placed_parts(drawn, _usual_rule, exact=False)
    parts = [_with_angle_of_file(part, of) for part, of in zip(parts, drawn, strict=True)]
    points = [*reader.pads(drawn, shapes), *reader.vias(sections["ROUTES"]), *reader.test_pins(sections["TESTPINS"])]
    notes += contours.notes
    if unknown:
        text = "{count} components are not placed; they were left out: {names}."
        notes.append(noted("parts-not-placed", text, count=len(unknown), names=", ".join(sorted(unknown)[:8])))
    notes += vias_without_mask(points, ("top", "bottom") if reader.states_mask else ())
    if reader.unclear:
        text = "no track shows on which side some pads of {names} are; check the test points of these parts."
        notes.append(noted("pad-sides-unclear", text, count=len(reader.unclear), names=reader.unclear))
    return Design(
        name,
        "gencad",
        tuple(parts),
        contours.outline,
        contours.others,
        net_points=numbered(points),
        notes=tuple(notes),
    )


def _sections(text: str, path: Path) -> dict[str, list[_Line]]:
    """Return the lines of every section `$NAME … $ENDNAME`."""
    found: defaultdict[str, list[_Line]] = defaultdict(list)
    current = ""
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.strip()
        if line.startswith("$END"):
            current = ""
        elif line.startswith("$"):
            current = line[1:].split()[0].upper() if len(line) > 1 else ""
        elif line and current in _SECTIONS:
            found[current].append(_Line(number, _words(line)))
    for section in ("HEADER", "COMPONENTS"):
        if not found[section]:
            raise InputError(f"{path}: has no section ${section}; it is no complete GenCAD file.")
    return found


def _words(line: str) -> list[str]:
    if '"' not in line:
        return line.split()
    try:
        return shlex.split(line, posix=True)
    except ValueError:  # a quotation mark within a name
        return line.replace('"', " ").split()


def _unit(line: _Line, path: Path) -> float:
    kind, count = line.word(1).upper(), number_of(line.word(2))
    if kind in _UNITS:
        return _UNITS[kind]
    # USER n: n units are one inch. USERCM, USERMM: n units are one centimetre, one millimetre.
    per = {"USER": 25.4, "USERCM": 10.0, "USERMM": 1.0}.get(kind)
    if per is None or count is None or count < LEAST_UNITS:
        where, stated = f"{path}, line {line.number}", " ".join(line.words[1:])
        raise InputError.field(where, "UNITS", stated, f"{', '.join(_UNITS)} or USER n")
    return per / count


class _Reader:
    """Reads the lines of one file, in its unit."""

    def __init__(self, path: Path, mm: float, sections: dict[str, list[_Line]]) -> None:
        self._path, self._mm = path, mm
        self._pads = self._pads_of(sections["PADS"], sections["PADSTACKS"])
        self._layers = self._layers_of(sections["PADSTACKS"])
        self.states_mask = any("SOLDERMASK" in layer for layers in self._layers.values() for layer in layers)
        """Whether pad stacks state where solder mask is open."""
        self.unclear: list[str] = []
        """Parts with pads of which nothing says on which side they are."""
        self._routes = sections["ROUTES"]
        self._shapes = self._shapes_of(sections["SHAPES"])
        self._signals = _Signals(sections["SIGNALS"], sections["ROUTES"], mm)

    def _numbers(self, line: _Line, first: int, count: int) -> list[float]:
        """Return `count` numbers of a line in mm, from word `first` on."""
        values = [v * self._mm for w in line.words[first : first + count] if (v := number_of(w)) is not None]
        if len(values) != count:
            shown = " ".join(line.words)
            where = f"{self._path}, line {line.number}"
            raise InputError(f"{where}: {shown!r} must have {count} numbers after word {first}.")
        return values

    def _piece(self, line: _Line) -> list[XY]:
        kind = line.word(0)
        if kind == "LINE":
            x0, y0, x1, y1 = self._numbers(line, 1, 4)
            return [(x0, y0), (x1, y1)]
        if kind == "ARC":
            x0, y0, x1, y1, cx, cy = self._numbers(line, 1, 6)
            return arc_points((x0, y0), (x1, y1), (cx, cy), clockwise=False)
        if kind == "CIRCLE":
            x, y, r = self._numbers(line, 1, 3)
            return circle_points((x, y), abs(r))
        if kind == "RECTANGLE":
            x, y, w, h = self._numbers(line, 1, 4)
            return [(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)]
        return []

    def edges(self, lines: list[_Line]) -> Iterator[list[XY]]:
        """Yield the pieces of the outline and of the cut-outs, without those of masks and artwork."""
        is_edge = True
        for line in lines:
            if line.word(0) in ("ARTWORK", "MASK", "TEXT", "CUTOUT"):
                is_edge = line.word(0) == "CUTOUT"
            elif is_edge:
                yield self._piece(line)

    def _pads_of(self, pads: list[_Line], stacks: list[_Line]) -> dict[str, Box]:
        """Return pad stack → its box at rotation 0."""
        points: defaultdict[str, list[XY]] = defaultdict(list)
        name = ""
        for line in pads:
            if line.word(0) == "PAD":
                name = line.word(1)
                points[name] = []
            else:
                points[name] += self._piece(line)
        boxes = {name: box for name, of in points.items() if (box := box_around(of)) is not None}
        found: dict[str, Box] = {}
        for line in stacks:
            if line.word(0) == "PADSTACK" and len(line.words) > 1:
                name = line.word(1)
            elif line.word(0) == "PAD" and line.word(1) in boxes:
                found.setdefault(name, boxes[line.word(1)])
        return found

    @staticmethod
    def _layers_of(stacks: list[_Line]) -> dict[str, set[str]]:
        found: dict[str, set[str]] = {}
        layers = set[str]()
        for line in stacks:
            if line.word(0) == "PADSTACK":
                layers = found.setdefault(line.word(1), set())
            elif line.word(0) == "PAD":
                layers.add(line.word(2).upper())
        return found

    def pads(self, drawn: Sequence[DrawnPart], shapes: Sequence[str]) -> Iterator[NetPoint]:
        """Yield the pads of the parts where the rules of their sides place them."""
        rules = rules_of(drawn, _usual_rule)
        for of, name in zip(drawn, shapes, strict=True):
            part, side = of.part, of.part.side
            at = rules[side, of.word].place(part)
            lines = dict[tuple[str, XY], tuple[_ShapePin, set[str]]]()
            for pin in self._shapes.get(name, _Shape()).pins:
                own = self._layers.get(pin.stack, {pin.layer if pin.layer == "BOTTOM" else "TOP"})
                lines.setdefault((pin.name, pin.at), (pin, set()))[1].update({"TOP", "BOTTOM"} & own)
            placed = [(pin, at.apply(pin.at), copper) for pin, copper in lines.values() if copper]
            exchanged = self._is_exchanged(of, [(pin.name, place, copper) for pin, place, copper in placed])
            for pin, place, copper in placed:
                through = len(copper) > 1
                below = (copper == {"BOTTOM"}) != exchanged
                box, net = self._pads.get(pin.stack), self._signals.name(part.ref, pin.name)
                kind: PointKind = "pin" if through else "pad"
                sides = through or not below, through or below
                yield NetPoint(part.ref, pin.name, net, place, *sides, kind, min(box.size) if box else None)

    def _is_exchanged(self, of: DrawnPart, placed: Sequence[tuple[str, XY, set[str]]]) -> bool:
        """Return whether the stacks of pads on one side are those of the other; `placed`: pins, places and layers."""
        pads = [
            (self._signals.name(of.part.ref, pin), place, next(iter(copper)))
            for pin, place, copper in placed
            if len(copper) == 1
        ]
        stated, side = {layer for _, _, layer in pads}, of.part.side.upper()
        if not stated or (side == "TOP" and "TOP" in stated):
            return False
        if len(stated) < 2 and (side == "BOTTOM" or len(pads) == len(placed)):
            # Of the side of the part, or of the board; EasyEDA writes a shape once, with the stacks of its first use.
            return side not in stated
        # Pads of both sides, as of an edge connector, or beside pins. Tracks end on the side of their pad.
        tracks, nowhere, other = self._tracks, Openings(()), {"TOP": "BOTTOM", "BOTTOM": "TOP"}
        as_stated = sum(place in tracks.get((net, layer), nowhere) for net, place, layer in pads)
        on_other = sum(place in tracks.get((net, other[layer]), nowhere) for net, place, layer in pads)
        if as_stated == on_other:
            self.unclear.append(of.part.ref)
            return "FLIP" in of.word
        return on_other > as_stated

    @cached_property
    def _tracks(self) -> dict[tuple[str, str], Openings]:
        """Ends of tracks by net and layer."""
        ends: defaultdict[tuple[str, str], list[XY]] = defaultdict(list)
        net = layer = ""
        for line in self._routes:
            if line.word(0) == "ROUTE":
                net = line.word(1)
            elif line.word(0) == "LAYER":
                layer = line.word(1).upper()
            elif line.word(0) in ("LINE", "ARC"):
                ends[net, layer] += _points(line.words[1:5], self._mm)
        return {key: Openings(places) for key, places in ends.items()}

    def vias(self, routes: list[_Line]) -> Iterator[NetPoint]:
        """Yield vias and test pads. Files that state no mask do not say which vias it covers: then none is."""
        net = ""
        for line in routes:
            if line.word(0) == "ROUTE":
                net = line.word(1)
            elif line.word(0) in ("VIA", "TESTPAD") and (at := _points(line.words[2:4], self._mm)):
                layers, box = self._layers.get(line.word(1), {"TOP", "BOTTOM"}), self._pads.get(line.word(1))
                is_via = line.word(0) == "VIA"
                top, bottom = (
                    side in layers and not (is_via and self.states_mask and f"SOLDERMASK_{side}" not in layers)
                    for side in ("TOP", "BOTTOM")
                )
                kind: PointKind = "via" if is_via else "pad"
                name = "" if is_via else line.word(6)
                yield NetPoint("", "", net, at[0], top, bottom, kind, min(box.size) if box else None, name)

    def test_pins(self, lines: list[_Line]) -> Iterator[NetPoint]:
        """Yield the test pins that have a place, by their names."""
        for line in lines:
            at = _points(line.words[2:4], self._mm) if line.word(0) == "TESTPIN" else []
            if at and number_of(line.word(2)) != _NOWHERE:
                below = line.words[-1].upper() == "BOTTOM"
                yield NetPoint("", "", line.word(4), at[0], not below, below, name=line.word(1))

    def _shapes_of(self, lines: list[_Line]) -> dict[str, _Shape]:
        found: dict[str, _Shape] = {}
        shape = _Shape()
        for line in lines:
            kind, words = line.word(0), line.words
            if kind == "SHAPE" and len(words) > 1:
                shape = found[words[1]] = _Shape()
            elif kind == "PIN" and len(words) > 5:
                x, y = self._numbers(line, 3, 2)
                shape.pins.append(
                    _ShapePin(words[1], words[2], (x, y), words[5].upper(), number_of(line.word(6)) or 0.0)
                )
            elif kind == "HEIGHT":
                shape.height = self._numbers(line, 1, 1)[0]
            elif piece := self._piece(line):
                shape.drawing.append(piece)
        return found

    def part(self, found: dict[str, _Line]) -> DrawnPart:
        """Return a component that is placed, from its lines by their first words."""
        nothing = _Line(0, [])
        x, y = self._numbers(found["PLACE"], 1, 2)
        side: Side = "bottom" if "BOTTOM" in [w.upper() for w in found.get("LAYER", nothing).words] else "top"
        rotation = self._numbers(found["ROTATION"], 1, 1)[0] / self._mm if "ROTATION" in found else 0.0
        of_shape = found.get("SHAPE", nothing)
        shape = self._shapes.get(of_shape.word(1), _Shape())
        package = of_shape.word(1).rpartition(":")[2]
        sizes = [max(self._pads[pin.stack].size) for pin in shape.pins if pin.stack in self._pads]
        height = self._numbers(found["HEIGHT"], 1, 1)[0] if "HEIGHT" in found else shape.height
        ref = found["COMPONENT"].word(1)
        part = Part(
            ref,
            side,
            (x, y),
            rotation,
            package,
            box=box_around(p for piece in shape.drawing for p in piece),
            body_height=height or None,
            is_mark="fiducial" in package.lower(),
            mark_diameter=sizes[0] if sizes else None,
            line=found["COMPONENT"].number,
        )
        pins = (Pin(pin.at, self._signals.ends(ref, pin.name, (x, y), math.hypot(*pin.at))) for pin in shape.pins)
        corners = (corner for pin in shape.pins for corner in self._corners(pin))
        word = " ".join(w.upper() for w in of_shape.words[2:4] if w != "0")
        known = tuple(pin for pin in pins if pin.places)
        return DrawnPart(part, (known,), word, box_around(corners), pads_count=True)

    def _corners(self, pin: _ShapePin) -> list[XY]:
        box = self._pads.get(pin.stack)
        return [pin.at] if box is None else box.corners(Placement(False, pin.degrees, pin.at))


class _Signals:
    """The ends of the tracks of every signal."""

    def __init__(self, signals: list[_Line], routes: list[_Line], mm: float) -> None:
        self._of_pin: dict[tuple[str, str], str] = {}
        self._nails: defaultdict[tuple[str, str], list[XY]] = defaultdict(list)
        ends: defaultdict[str, set[XY]] = defaultdict(set)
        name = ""
        for _, words in signals:
            if words[0] == "SIGNAL" and len(words) > 1:
                name = words[1]
            elif words[0] == "NODE" and len(words) > 2:
                self._of_pin[words[1], words[2]] = name
            elif words[0] == "NAILLOC" and len(words) > 5:
                self._nails[words[1], words[2]] += _points(words[4:6], mm)
        for _, words in routes:
            if words[0] == "ROUTE" and len(words) > 1:
                name = words[1]
            elif words[0] in ("LINE", "ARC"):
                ends[name].update(_points(words[1:5], mm))
            elif words[0] == "VIA":
                ends[name].update(_points(words[2:4], mm))
        self._ends = {name: np.array(sorted(points)) for name, points in ends.items() if points}

    def name(self, ref: str, pin: str) -> str:
        """Return the signal of a pin; empty if it has none."""
        return self._of_pin.get((ref, pin), "")

    def ends(self, ref: str, pin: str, origin: XY, distance: float) -> tuple[XY, ...]:
        """Return the ends on which a pin may lie: those of its signal at its distance from the origin of its part."""
        ends, nails = self._ends.get(self._of_pin.get((ref, pin), "")), self._nails.get((ref, pin), ())
        if ends is None:
            return tuple(nails)
        near = ends[np.abs(np.hypot(*(ends - origin).T) - distance) <= FITS_MM]
        return (*nails, *((float(x), float(y)) for x, y in near))


def _points(words: list[str], mm: float) -> list[XY]:
    """Return the points that pairs of words state, mm; none if a word is no number."""
    values = [value * mm for word in words if (value := number_of(word)) is not None]
    whole = len(values) == len(words) and len(words) % 2 == 0
    return list(zip(values[::2], values[1::2], strict=True)) if whole else []


def _usual_rule(_side: Side, word: str) -> Rule:
    """Return the rule of the specification: MIRRORY is about the y axis, MIRRORX and FLIP alone about the x axis."""
    return Rule(bool(word), 1, 180.0 if word and "MIRRORY" not in word else 0.0)


def _with_angle_of_file(part: Part, drawn: DrawnPart) -> Part:
    """Return a part that was mirrored about the x axis with the angle of the file; its frame turns by 180°."""
    if _usual_rule(part.side, drawn.word).offset == 0.0:
        return part
    box = part.box
    turned = Box((-box.high[0], -box.high[1]), (-box.low[0], -box.low[1])) if box is not None else None
    return replace(part, rotation=normalised(part.rotation + 180), box=turned)


def _components(lines: list[_Line]) -> Iterator[dict[str, _Line]]:
    found: dict[str, _Line] = {}
    for line in [*lines, _Line(0, ["COMPONENT"])]:
        if line.word(0) == "COMPONENT":
            if found:
                yield found
            found = {"COMPONENT": line} if len(line.words) > 1 else {}
        elif found:
            found.setdefault(line.word(0), line)
