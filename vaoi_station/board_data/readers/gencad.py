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
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from vaoi_station.board_data.contours import arc_points, circle_points, find_contours
from vaoi_station.board_data.design import XY, Box, Design, Part, Side, box_around, normalised, rotated
from vaoi_station.board_data.pin_rules import FITS_MM, DrawnPart, Pin, Rule, placed_parts
from vaoi_station.board_data.source_text import decode, number_of
from vaoi_station.errors import InputError
from vaoi_station.model.reason import Note

_UNITS = {"INCH": 25.4, "THOU": 0.0254, "MM": 1.0, "MM100": 0.01}
_SECTIONS = frozenset(("HEADER", "BOARD", "PADS", "PADSTACKS", "SHAPES", "COMPONENTS", "SIGNALS", "ROUTES"))
LEAST_UNITS = 1e-3
"""Smallest n of `USER n`: a unit of 25 m."""
Line = tuple[int, list[str]]
"""Number of a line of the file, and its words."""


def is_gencad(head: bytes) -> bool:
    """Return whether a file begins like a GenCAD file."""
    return b"$HEADER" in head and b"GENCAD" in head


@dataclass
class _Shape:
    drawing: list[list[XY]] = field(default_factory=list)
    pins: list[tuple[str, XY, float]] = field(default_factory=list)
    """Pad stack, place and rotation of every pin."""
    names: list[str] = field(default_factory=list)
    """Names of the pins."""
    height: float | None = None


def read_gencad(data: bytes, path: Path) -> Design:
    """Read a GenCAD file."""
    sections = _sections(decode(data, path), path)
    mm, name = 1.0, path.stem
    for number, words in sections["HEADER"]:
        if words[0] == "UNITS":
            mm = _unit(words, path, number)
        elif words[0] == "DRAWING" and len(words) > 1:
            name = words[1].removesuffix(".kicad_pcb")
    reader = _Reader(path, mm)
    pads = reader.pads(sections["PADS"], sections["PADSTACKS"])
    shapes = reader.shapes(sections["SHAPES"])
    contours = find_contours(_without_art(reader, sections["BOARD"]), "$BOARD")
    signals = _Signals(sections["SIGNALS"], sections["ROUTES"], mm)
    drawn, unknown = [], set()
    for component in _components(sections["COMPONENTS"]):
        part = reader.part(component, shapes, pads, signals)
        if part is None:
            unknown.add(component["COMPONENT"][1][1])
        else:
            drawn.append(part)
    # Tracks have corners where other pins would be, so that they show the rule of a side, but not the angle of a part.
    parts, notes = placed_parts(drawn, _usual_rule, exact=False)
    parts = [_with_angle_of_file(part, of) for part, of in zip(parts, drawn, strict=True)]
    notes += contours.notes
    if unknown:
        names = ", ".join(sorted(unknown)[:8])
        sentence = f"{len(unknown)} components are not placed; they were left out: {names}."
        notes.append(Note("parts-not-placed", sentence, count=len(unknown), names=names))
    return Design(name, "gencad", tuple(parts), contours.outline, contours.others, notes=tuple(notes))


def _sections(text: str, path: Path) -> dict[str, list[Line]]:
    """Return the lines of every section `$NAME … $ENDNAME` as words."""
    found: defaultdict[str, list[Line]] = defaultdict(list)
    current = ""
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.strip()
        if line.startswith("$END"):
            current = ""
        elif line.startswith("$"):
            current = line[1:].split()[0].upper() if len(line) > 1 else ""
        elif line and current in _SECTIONS:
            found[current].append((number, _words(line)))
    if not found["HEADER"] or not found["COMPONENTS"]:
        missing = "$HEADER" if not found["HEADER"] else "$COMPONENTS"
        raise InputError(f"{path}: has no section {missing}; it is no complete GenCAD file.")
    return found


def _words(line: str) -> list[str]:
    if '"' not in line:
        return line.split()
    try:
        return shlex.split(line, posix=True)
    except ValueError:  # a quotation mark within a name
        return line.replace('"', " ").split()


def _unit(words: list[str], path: Path, number: int) -> float:
    kind = words[1].upper() if len(words) > 1 else ""
    if kind in _UNITS:
        return _UNITS[kind]
    # USER n: n units are one inch. USERCM, USERMM: n units are one centimetre, one millimetre.
    per = {"USER": 25.4, "USERCM": 10.0, "USERMM": 1.0}.get(kind)
    count = number_of(words[2]) if len(words) > 2 else None
    if per is None or count is None or count < LEAST_UNITS:
        raise InputError.field(f"{path}, line {number}", "UNITS", " ".join(words[1:]), f"{', '.join(_UNITS)} or USER n")
    return per / count


class _Reader:
    """Reads the lines of one file, in its unit."""

    def __init__(self, path: Path, mm: float) -> None:
        self._path, self._mm = path, mm

    def numbers(self, line: Line, first: int, count: int) -> list[float]:
        """Return `count` numbers of a line in mm, from word `first` on."""
        number, words = line
        values = [v * self._mm for w in words[first : first + count] if (v := number_of(w)) is not None]
        if len(values) != count:
            raise InputError(
                f"{self._path}, line {number}: {' '.join(words)!r} must have {count} numbers after word {first}."
            )
        return values

    def piece(self, line: Line) -> list[XY] | None:
        """Return a line of a drawing as points; None if it is no drawing."""
        kind = line[1][0]
        if kind == "LINE":
            x0, y0, x1, y1 = self.numbers(line, 1, 4)
            return [(x0, y0), (x1, y1)]
        if kind == "ARC":
            x0, y0, x1, y1, cx, cy = self.numbers(line, 1, 6)
            return arc_points((x0, y0), (x1, y1), (cx, cy), clockwise=False)
        if kind == "CIRCLE":
            x, y, r = self.numbers(line, 1, 3)
            return circle_points((x, y), abs(r))
        if kind == "RECTANGLE":
            x, y, w, h = self.numbers(line, 1, 4)
            return [(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)]
        return None

    def pads(self, pads: list[Line], stacks: list[Line]) -> dict[str, Box]:
        """Return pad stack → its box at rotation 0."""
        boxes: dict[str, Box] = {}
        name, points = "", list[XY]()
        for line in [*pads, (0, ["PAD", ""])]:
            if line[1][0] == "PAD":
                if (box := box_around(points)) is not None:
                    boxes[name] = box
                name, points = line[1][1] if len(line[1]) > 1 else "", []
            else:
                points += self.piece(line) or []
        found: dict[str, Box] = {}
        for _, words in stacks:
            if words[0] == "PADSTACK" and len(words) > 1:
                name = words[1]
            elif words[0] == "PAD" and len(words) > 1 and words[1] in boxes:
                found.setdefault(name, boxes[words[1]])
        return found

    def shapes(self, lines: list[Line]) -> dict[str, _Shape]:
        found: dict[str, _Shape] = {}
        shape = _Shape()
        for line in lines:
            words = line[1]
            if words[0] == "SHAPE" and len(words) > 1:
                shape = found[words[1]] = _Shape()
            elif words[0] == "PIN" and len(words) > 5:
                x, y = self.numbers(line, 3, 2)
                turn = number_of(words[6]) if len(words) > 6 else None
                shape.pins.append((words[2], (x, y), turn or 0.0))
                shape.names.append(words[1])
            elif words[0] == "HEIGHT":
                shape.height = self.numbers(line, 1, 1)[0]
            elif (piece := self.piece(line)) is not None:
                shape.drawing.append(piece)
        return found

    def part(
        self, found: dict[str, Line], shapes: dict[str, _Shape], pads: dict[str, Box], signals: _Signals
    ) -> DrawnPart | None:
        """Return a component; None if it is not placed."""
        if "PLACE" not in found:
            return None
        x, y = self.numbers(found["PLACE"], 1, 2)
        side: Side = "bottom" if "BOTTOM" in [w.upper() for w in found.get("LAYER", (0, []))[1]] else "top"
        rotation = self.numbers(found["ROTATION"], 1, 1)[0] / self._mm if "ROTATION" in found else 0.0
        words = found.get("SHAPE", (0, ["SHAPE", ""]))[1]
        name = words[1] if len(words) > 1 else ""
        shape = shapes.get(name, _Shape())
        package = name.rpartition(":")[2]
        is_mark = "fiducial" in package.lower()
        sizes = [max(pads[stack].size) for stack, _, _ in shape.pins if stack in pads]
        height = self.numbers(found["HEIGHT"], 1, 1)[0] if "HEIGHT" in found else shape.height
        line, (_, ref, *_) = found["COMPONENT"]
        drawing = box_around(p for piece in shape.drawing for p in piece)
        part = Part(
            ref, side, (x, y), rotation, package, box=drawing, body_height=height or None, is_mark=is_mark,
            mark_diameter=sizes[0] if sizes else None, line=line,
        )  # fmt: skip
        pins = (
            Pin(at, signals.ends(ref, pin, (x, y), math.hypot(*at)))
            for pin, (_, at, _) in zip(shape.names, shape.pins, strict=True)
        )
        pad_box = box_around(p for pin in shape.pins for p in _pad_corners(pin, pads))
        word = " ".join(w.upper() for w in words[2:4] if w != "0")
        return DrawnPart(part, (tuple(pin for pin in pins if pin.places),), word, pad_box, pads_count=True)


class _Signals:
    """The ends of the tracks of every signal."""

    def __init__(self, signals: list[Line], routes: list[Line], mm: float) -> None:
        self._of_pin: dict[tuple[str, str], str] = {}
        nails: defaultdict[tuple[str, str], list[XY]] = defaultdict(list)
        ends: defaultdict[str, set[XY]] = defaultdict(set)
        name = ""
        for _, words in signals:
            if words[0] == "SIGNAL" and len(words) > 1:
                name = words[1]
            elif words[0] == "NODE" and len(words) > 2:
                self._of_pin[words[1], words[2]] = name
            elif words[0] == "NAILLOC" and len(words) > 5:
                nails[words[1], words[2]] += _points(words[4:6], mm)
        for _, words in routes:
            if words[0] == "ROUTE" and len(words) > 1:
                name = words[1]
            elif words[0] in ("LINE", "ARC"):
                ends[name].update(_points(words[1:5], mm))
            elif words[0] == "VIA":
                ends[name].update(_points(words[2:4], mm))
        self._ends = {name: np.array(sorted(points)) for name, points in ends.items() if points}
        self._nails = dict(nails)

    def ends(self, ref: str, pin: str, origin: XY, distance: float) -> tuple[XY, ...]:
        """Return the ends on which a pin may lie: those of its signal at its distance from the origin of its part."""
        ends = self._ends.get(self._of_pin.get((ref, pin), ""))
        if ends is None:
            return tuple(self._nails.get((ref, pin), ()))
        near = ends[np.abs(np.hypot(*(ends - origin).T) - distance) <= FITS_MM]
        return (*self._nails.get((ref, pin), ()), *((float(x), float(y)) for x, y in near))


def _points(words: list[str], mm: float) -> list[XY]:
    """Return the points that pairs of words state, mm; none if a word is no number."""
    values = [value * mm for word in words if (value := number_of(word)) is not None]
    return (
        list(zip(values[::2], values[1::2], strict=True)) if len(values) == len(words) and len(words) % 2 == 0 else []
    )


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


def _components(lines: list[Line]) -> Iterator[dict[str, Line]]:
    """Yield the lines of every component by their first word."""
    found: dict[str, Line] = {}
    for line in lines:
        if line[1][0] == "COMPONENT":
            if found:
                yield found
            found = {}
            if len(line[1]) < 2:
                continue
        if found or line[1][0] == "COMPONENT":
            found.setdefault(line[1][0], line)
    if found:
        yield found


def _without_art(reader: _Reader, lines: list[Line]) -> Iterator[list[XY]]:
    """Yield the pieces of the outline and of the cut-outs, without those of masks and artwork."""
    is_edge = True
    for line in lines:
        if line[1][0] in ("ARTWORK", "MASK", "TEXT"):
            is_edge = False
        elif line[1][0] == "CUTOUT":
            is_edge = True
        elif is_edge and (piece := reader.piece(line)) is not None:
            yield piece


def _pad_corners(pin: tuple[str, XY, float], pads: dict[str, Box]) -> list[XY]:
    stack, (x, y), turn = pin
    box = pads.get(stack)
    if box is None:
        return [(x, y)]
    corners = [rotated((cx, cy), turn) for cx in (box.low[0], box.high[0]) for cy in (box.low[1], box.high[1])]
    return [(x + cx, y + cy) for cx, cy in corners]
