"""Read the packages of an ODB++ design (`eda/data`), and the toeprints of its components."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from vaoi_station.board_data.contours import circle_points
from vaoi_station.board_data.design import KICAD_COURTYARD_MM, XY, Box, box_around
from vaoi_station.board_data.pin_rules import Pin
from vaoi_station.board_data.source_text import number_of
from vaoi_station.errors import InputError

UNITS = {"MM": 1.0, "INCH": 25.4}
_LEAST_COURTYARD_MM = 0.05
"""A courtyard is at least this far from every pin; KiCad's libraries have 0.15 and more."""


class OdbFile:
    """The lines of one file, in its own unit."""

    def __init__(self, where: str, lines: list[str], default: float | None) -> None:
        self.where, self.lines = where, lines
        unit = next(
            (m[1].upper() for line in lines[:50] if (m := re.match(r"\s*(?:UNITS\s*=|U\s+)\s*(\w+)", line))), None
        )
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
        # KiCad writes the courtyard. Where a footprint has none it writes a hull of everything, which touches the pins.
        if by_kicad and outline is not None and pads is not None and outline.contains(pads, _LEAST_COURTYARD_MM):
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
    by_number = dict(enumerate(at for _, at in package.pins))
    by_name = dict(reversed(package.pins))
    return (
        tuple(Pin(by_number.get(t.number), (t.at,)) for t in toeprints),
        tuple(Pin(by_name.get(t.name), (t.at,)) for t in toeprints),
        tuple(Pin(by_number.get(t.number - 1), (t.at,)) for t in toeprints),
    )


def packages_of(file: OdbFile | None) -> list[Package]:
    """Return the packages in the order of their numbers, with the outline of their bodies and pins, mm."""
    found: list[Package] = []
    in_pin = False
    for number, line in enumerate(file.lines if file else [], 1):
        words = line.split(";")[0].split()
        if not words or file is None:
            continue
        if words[0] == "PKG" and len(words) >= 7:
            box = [v * file.mm for v in file.numbers(number, words[3:], 4)]
            found.append(Package(words[1]))
            found[-1].points = [(box[0], box[1]), (box[2], box[3])]
            in_pin, outlined = False, False
        elif not found:
            continue
        elif words[0] == "PIN":
            in_pin = True
            x, y = (number_of(word) for word in words[3:5]) if len(words) > 4 else (None, None)
            at = (x * file.mm, y * file.mm) if x is not None and y is not None else None
            found[-1].pins.append((words[1] if len(words) > 1 else "", at))
        elif words[0] in ("RC", "CR", "SQ", "OB", "OS", "OC"):
            points = outline_points(file, number, words)
            if in_pin:
                found[-1].pads += points
                box_of_pad = box_around(points)
                if box_of_pad and found[-1].pad is None:
                    found[-1].pad = max(box_of_pad.size)
            elif not outlined or words[0] in ("OS", "OC"):
                # The first outline replaces the bounding box of the line PKG, which includes the pins.
                found[-1].points = [*(found[-1].points if outlined else []), *points]
                outlined = True
    return found


def outline_points(file: OdbFile, number: int, words: list[str]) -> list[XY]:
    """Return the corners of a shape of a package, or the point of a contour, mm."""
    kind = words[0]
    count = {"RC": 4, "CR": 3, "SQ": 3, "OB": 2, "OS": 2, "OC": 4}[kind]
    v = [x * file.mm for x in file.numbers(number, words[1:], count)]
    if kind == "RC":
        return [(v[0], v[1]), (v[0] + v[2], v[1] + v[3])]
    if kind == "CR":
        return circle_points((v[0], v[1]), v[2])
    if kind == "SQ":
        return [(v[0] - v[2], v[1] - v[2]), (v[0] + v[2], v[1] + v[2])]
    return [(v[0], v[1])]
