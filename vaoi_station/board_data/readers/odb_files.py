"""The files of an ODB++ design, line by line: packages and toeprints, fiducials of features, headers of steps."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from vaoi_station.board_data.contours import circle_points
from vaoi_station.board_data.design import KICAD_COURTYARD_MM, XY, Box, Mark, MarkKind, Side, box_around
from vaoi_station.board_data.marks import kind_by_name
from vaoi_station.board_data.panels import Repeat
from vaoi_station.board_data.panels.step_and_repeat import stated_count, stated_number
from vaoi_station.board_data.pin_rules import Pin
from vaoi_station.board_data.source_text import number_of
from vaoi_station.errors import InputError

UNITS = {"MM": 1.0, "INCH": 25.4}
_LEAST_COURTYARD_MM = 0.05
"""A courtyard is at least this far from every pin; KiCad's libraries have 0.15 and more."""
_USAGES: dict[str, MarkKind] = {"2": "global", "g_fiducial": "global", "3": "local", "l_fiducial": "local"}
"""Values of `.pad_usage` that mark fiducials; files state the number of the option."""
_COPPER = ("SIGNAL", "POWER_GROUND", "MIXED")
_SYMBOL = re.compile(
    r"(?:r|s|di|rect|oval|oct|hex_[ls]|donut_[a-z]+)(\d+(?:\.\d+)?)(?:$|x(\d+(?:\.\d+)?)?)", re.IGNORECASE
)
"""Standard symbols, whose name states their size; `fid_100` of a design may have any."""
_FEATURES = frozenset("LATB")
"""First words of features other than pads and surfaces."""
MOST_MARKS = 1_000
_BLOCK = re.compile(r"\s*STEP-REPEAT\s*\{?\s*$", re.IGNORECASE)
MOST_BLOCKS = 10_000


class OdbFile:
    """The lines of one file, in its own unit."""

    def __init__(self, where: str, lines: list[str], default: float | None) -> None:
        self.where, self.lines = where, lines
        stated = (re.match(r"\s*(?:UNITS\s*=|U\s+)\s*(\w+)", line) for line in lines[:50])
        unit = next((match[1].upper() for match in stated if match), None)
        if unit is not None and unit not in UNITS:
            raise InputError.field(where, "UNITS", unit, "MM or INCH")
        # Until version 7 a file without UNITS is in inches.
        self.mm = UNITS[unit] if unit else (default if default is not None else 25.4)

    def numbers(self, number: int, words: list[str], count: int) -> list[float]:
        """Return the first `count` words as numbers, unscaled."""
        found = [v for w in words[:count] if (v := number_of(w)) is not None]
        if len(found) != count:
            raise InputError(f"{self.where}, line {number}: {self.lines[number - 1][:80]!r} must have {count} numbers.")
        return found


def attributes_of(line: str, names: dict[str, str]) -> dict[str, str]:
    """Return name → value of the attributes of a line: `…;0=0.0374,1=0;ID=2083`; `names` are those of the file."""
    pairs = (item.strip().partition("=") for item in line.partition(";")[2].partition(";")[0].split(","))
    return {names[key].lower(): value for key, _, value in pairs if key in names}


# Packages (`eda/data`) and the toeprints of components.


@dataclass
class Package:
    """A package: outline and pins in its own frame, mm."""

    name: str
    points: list[XY] = field(default_factory=list)
    """Corners of the outline."""
    pads: list[XY] = field(default_factory=list)
    """Corners of the pins."""
    pins: list[tuple[str, XY | None]] = field(default_factory=list)
    """Name and place of every pin; None if the file states no place."""
    pad: float | None = None
    """Largest extent of its first pin."""

    def box(self, by_kicad: bool) -> Box | None:
        """Return the box of the body; None if the package has none."""
        outline, pads = box_around(self.points), box_around(self.pads)
        if by_kicad and outline is not None and pads is not None:
            # KiCad writes the courtyard. Where a footprint has none it writes a hull of everything, which touches pins.
            below = all(a + _LEAST_COURTYARD_MM <= b for a, b in zip(outline.low, pads.low, strict=True))
            if below and all(b + _LEAST_COURTYARD_MM <= a for a, b in zip(outline.high, pads.high, strict=True)):
                return outline.shrunk(KICAD_COURTYARD_MM)
        return outline


class Toeprint(NamedTuple):
    """A pin of a component on the board."""

    number: int
    """Index of the pin in its package, from 0."""
    name: str
    at: XY


def toeprint_of(line: str, mm: float) -> Toeprint | None:
    """Return the toeprint of a line `TOP number x y rotation mirror net subnet name`; None if it states no place."""
    words = line.partition(";")[0].split()
    x, y = (number_of(word) for word in words[2:4]) if len(words) > 3 else (None, None)
    if x is None or y is None or not re.fullmatch(r"\d{1,6}", words[1]):
        return None
    return Toeprint(int(words[1]), words[8] if len(words) > 8 else "", (x * mm, y * mm))


def readings(package: Package, toeprints: Sequence[Toeprint]) -> tuple[tuple[Pin, ...], ...]:
    """Return the pins of a component by their numbers from 0, by their names, and by their numbers from 1."""
    by_number, by_name = dict(enumerate(at for _, at in package.pins)), dict(reversed(package.pins))
    return (
        tuple(Pin(by_number.get(t.number), (t.at,)) for t in toeprints),
        tuple(Pin(by_name.get(t.name), (t.at,)) for t in toeprints),
        tuple(Pin(by_number.get(t.number - 1), (t.at,)) for t in toeprints),
    )


def packages_of(file: OdbFile | None) -> list[Package]:
    """Return the packages in the order of their numbers, with the outline of their bodies and pins, mm."""
    found: list[Package] = []
    in_pin = outlined = False
    for number, line in enumerate(file.lines if file else [], 1):
        words = line.split(";")[0].split()
        if not words or file is None:
            continue
        if words[0] == "PKG" and len(words) >= 7:
            x0, y0, x1, y1 = (v * file.mm for v in file.numbers(number, words[3:], 4))
            found.append(Package(words[1], [(x0, y0), (x1, y1)]))
            in_pin = outlined = False
        elif not found:
            continue
        elif words[0] == "PIN":
            in_pin = True
            x, y = (number_of(word) for word in words[3:5]) if len(words) > 4 else (None, None)
            at = (x * file.mm, y * file.mm) if x is not None and y is not None else None
            found[-1].pins.append((words[1] if len(words) > 1 else "", at))
        elif words[0] in _COUNTS:
            package, points = found[-1], outline_points(file, number, words)
            if in_pin:
                package.pads += points
                if package.pad is None and (box := box_around(points)):
                    package.pad = max(box.size)
            elif not outlined or words[0] in ("OS", "OC"):
                # The first outline replaces the bounding box of the line PKG, which includes the pins.
                package.points = [*(package.points if outlined else []), *points]
                outlined = True
    return found


_COUNTS = {"RC": 4, "CR": 3, "SQ": 3, "OB": 2, "OS": 2, "OC": 4}
"""Number of the numbers that a shape has."""


def outline_points(file: OdbFile, number: int, words: list[str]) -> list[XY]:
    """Return the corners of a shape of a package, or the point of a contour, mm."""
    kind = words[0]
    v = [x * file.mm for x in file.numbers(number, words[1:], _COUNTS[kind])]
    if kind == "RC":
        return [(v[0], v[1]), (v[0] + v[2], v[1] + v[3])]
    if kind == "CR":
        return circle_points((v[0], v[1]), v[2])
    if kind == "SQ":
        return [(v[0] - v[2], v[1] - v[2]), (v[0] + v[2], v[1] + v[2])]
    return [(v[0], v[1])]


# Fiducials of feature files: pads with the attributes `.pad_usage` and `.fiducial_name`.


def outer_layers(matrix: Sequence[str]) -> dict[Side, str]:
    """Return the names of the outer copper layers, in lower case, from the lines of `matrix/matrix`."""
    found = _rows(matrix, _COPPER)
    outer: dict[Side, str] = {"top": found[0][1]} if found else {}
    return outer | {"bottom": found[-1][1]} if len(found) > 1 else outer


def mask_layers(matrix: Sequence[str]) -> dict[Side, str]:
    """Return the names of the layers of solder mask: above and below all copper."""
    masks, copper = _rows(matrix, ("SOLDER_MASK",)), _rows(matrix, _COPPER)
    found: dict[Side, str] = {}
    for row, name in masks if copper else ():
        found["top" if row < copper[0][0] else "bottom"] = name
    return found


def _rows(matrix: Sequence[str], types: Sequence[str]) -> list[tuple[float, str]]:
    """Return the rows and names of the layers of some types, from the top on."""
    found: list[tuple[float, str]] = []
    entry: dict[str, str] = {}
    for line in map(str.strip, matrix):
        key, equals, value = line.partition("=")
        if line.startswith("LAYER"):
            entry = {}
        elif equals:
            entry[key] = value
        elif line == "}" and entry.get("TYPE", "").upper() in types:
            if (row := number_of(entry.get("ROW"))) is not None:
                found.append((row, entry.get("NAME", "").lower()))
            entry = {}
    return sorted(found)


# Nets (`eda/data`), and the pads of their toeprints and vias by the numbers of features.


class Copper(NamedTuple):
    """A pad or via of a net."""

    net: str
    toeprint: tuple[Side, int, int] | None
    """Side, number of the component, and number of its toeprint; None for a via."""
    features: dict[str, int]
    """Number of its feature by the name of the layer."""


def copper_of(file: OdbFile | None) -> list[Copper]:
    """Return the pads and vias of all nets."""
    found, layers, net, features = list[Copper](), list[str](), "", dict[str, int]()
    for line in file.lines if file else ():
        words = line.partition(";")[0].split() or [""]
        if words[0] == "LYR":
            layers = [word.lower() for word in words[1:]]
        elif words[0] == "NET":
            net = "" if words[1:2] in ([], ["$NONE$"]) else words[1]
        elif words[0] == "SNT":
            features = {}
            if words[1:2] == ["VIA"]:
                found.append(Copper(net, None, features))
            elif words[1:2] == ["TOP"] and len(words) > 4 and words[3].isdecimal() and words[4].isdecimal():
                side: Side = "bottom" if words[2] == "B" else "top"
                found.append(Copper(net, (side, int(words[3]), int(words[4])), features))
        elif words[:2] == ["FID", "C"] and len(words) > 3 and words[2].isdecimal() and words[3].isdecimal():
            features.setdefault("".join(layers[int(words[2]) :][:1]), int(words[3]))
    return found


class Pad(NamedTuple):
    """A pad of a layer: its middle, and its smallest extent if that is known, mm."""

    at: XY
    diameter: float | None


def placed_pads(file: OdbFile) -> dict[int, Pad]:
    """Return the pads of a layer by the numbers of their features; pads of any shape are drawn as surfaces."""
    sizes, found, number, corners = dict[str, float](), dict[int, Pad](), 0, list[XY]()
    for line in file.lines:
        words = line.lstrip("$").partition(";")[0].split() or [""]
        if line.startswith("$"):
            if len(words) > 1 and (size := _symbol_mm(words, file.mm)) is not None:
                sizes[words[0]] = min(size)
        elif words[0] in ("P", "OB", "OS", "OC"):
            x, y = (number_of(word) for word in words[1:3]) if len(words) > 2 else (None, None)
            if x is None or y is None:
                number += words[0] == "P"
            elif words[0] == "P":
                found[number] = Pad((x * file.mm, y * file.mm), sizes.get(words[3]) if len(words) > 3 else None)
                number += 1
            else:
                corners.append((x * file.mm, y * file.mm))
        elif words[0] == "SE":
            if (box := box_around(corners)) is not None:
                found[number] = Pad(box.center, min(box.size))
            number, corners = number + 1, []
        elif words[0] in _FEATURES:
            number += 1
    return found


def _symbol_mm(words: Sequence[str], mm: float) -> tuple[float, ...] | None:
    """Return the size, or width and height, that the name of a standard symbol states, mm."""
    size = _SYMBOL.match(words[1])
    unit = {"I": 25.4, "M": 1.0}.get(words[2] if len(words) > 2 else "", mm)
    return tuple(float(s) * unit / 1000 for s in size.groups() if s and float(s) > 0) or None if size else None


def pad_marks(lines: Sequence[str], mm: float, side: Side) -> Iterator[Mark]:
    """Yield the pads of a copper layer that are fiducials. `mm` is the unit; symbols are in a thousandth of it."""
    symbols: dict[str, float] = {}
    names: dict[str, str] = {}
    texts: dict[str, str] = {}
    count = 0
    for line in lines:
        words = line.lstrip("$").partition(";")[0].split()
        if line.startswith("$"):
            if len(words) > 1 and (size := _symbol_mm(words, mm)) is not None:
                symbols[words[0]] = size[0]
        elif match := re.match(r"([@&])(\d+)\s+(.*)", line):
            (names if match[1] == "@" else texts)[match[2]] = match[3].strip()
        elif line.startswith("P ") and ";" in line and count < MOST_MARKS and len(words) > 3:
            attributes = attributes_of(line, names)
            name = texts.get(attributes.get(".fiducial_name", "?"), attributes.get(".fiducial_name"))
            usage = _USAGES.get(attributes.get(".pad_usage", ""))
            x, y = number_of(words[1]), number_of(words[2])
            if (name is None and usage is None) or x is None or y is None:
                continue
            count += 1
            kind = usage or kind_by_name(name or "")
            yield Mark(name or f"{kind}{count}", side, (x * mm, y * mm), symbols.get(words[3]), kind, "attribute")


# The header of a step (`stephdr`): its datum and its blocks `STEP-REPEAT`. A block places the datum of a step at X, Y,
# and NX × NY times at distances DX, DY along the axes of the panel. The step turns clockwise by ANGLE about its datum.
# With MIRROR or FLIP it lies upside down: it is mirrored in x before it turns. Version 7 has MIRROR only.


def has_repeats(lines: Sequence[str]) -> bool:
    """Return whether the lines of a header have a block of step-and-repeat."""
    return any(_BLOCK.match(line) for line in lines)


def datum_of(header: OdbFile) -> XY:
    """Return the datum of a step; raise InputError if a value is no number, or a block has no end."""
    values: dict[str, str] = {}
    for _ in _blocks(header, values):
        pass
    x, y = (stated_number(header.where, values, key) for key in ("X_DATUM", "Y_DATUM"))
    return x * header.mm, y * header.mm


def repeats_of(header: OdbFile) -> tuple[Repeat, ...]:
    """Return the repeats of a step; raise InputError if a block has no name or no end, or a value is no number."""
    repeats = []
    for number, block in _blocks(header, {}):
        at = f"{header.where}, STEP-REPEAT in line {number}"
        if not block.get("NAME"):
            raise InputError(f"{at}: has no NAME of a step.")
        x, y, dx, dy = (stated_number(at, block, key) * header.mm for key in ("X", "Y", "DX", "DY"))
        counts = stated_count(at, block, "NX"), stated_count(at, block, "NY")
        mirrored = "YES" in (block.get("MIRROR", "").upper(), block.get("FLIP", "").upper())
        turn = -stated_number(at, block, "ANGLE")
        repeats.append(Repeat(block["NAME"].lower(), (x, y), (dx, dy), counts, turn, mirrored))
    return tuple(repeats)


def _blocks(header: OdbFile, outside: dict[str, str]) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield line and values of the blocks of step-and-repeat; what stands outside of all blocks is added."""
    block: tuple[int, dict[str, str]] | None = None
    where, count = header.where, 0
    for number, line in enumerate(header.lines, 1):
        key, equals, value = (word.strip() for word in line.partition("="))
        if _BLOCK.match(line):
            block, count = (number, {}), count + 1
            if count > MOST_BLOCKS:
                raise InputError.field(where, "the number of STEP-REPEAT", f"{count} or more", f"at most {MOST_BLOCKS}")
        elif key == "}":
            if block is not None:
                yield block
            block = None
        elif equals:
            (outside if block is None else block[1])[key.upper()] = value
    if block is not None:
        raise InputError(f"{where}: STEP-REPEAT in line {block[0]} has no end, '}}'.")
