"""Read EAGLE boards (`.brd`, XML since version 6).

Lengths are in mm, y points up. `rot="MR90"`: rotated by 90° counter-clockwise, then mirrored in x, which is a rotation
by −90° after the mirroring. Source: eagle.dtd, which comes with EAGLE; KiCad's importer for the order.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

from vaoi_station.board_data.contours import arc_points, circle_points, join
from vaoi_station.board_data.design import XY, Box, Design, Part, body_of, box_around, normalised
from vaoi_station.board_data.source_text import decode, number_of, parse_xml
from vaoi_station.errors import InputError
from vaoi_station.model.note import Note

_DIMENSION, _DOCUMENTATION, _PLACEMENT = "20", "51", "21"
"""Numbers of the layers for the outline of the board, and for the drawing of parts."""
_DOCTYPE = re.compile(r"<!DOCTYPE eagle SYSTEM \"eagle\.dtd\">")


def is_eagle(head: bytes) -> bool:
    """Return whether a file begins like an EAGLE board."""
    return b"<eagle" in head


def read_eagle(data: bytes, path: Path) -> Design:
    """Read an EAGLE board."""
    # EAGLE declares its own document type in every file; it has no entities, and any other declaration is refused.
    text = _DOCTYPE.sub("", decode(data, path), count=1)
    root = parse_xml(re.sub(r'encoding="[^"]*"', 'encoding="utf-8"', text, count=1).encode(), path)
    board = next(root.iter("board"), None)
    if board is None:
        raise InputError(f"{path}: has no <board>; it is a library or a schematic of EAGLE. Give the .brd file.")
    packages = {
        (library.get("name", ""), package.get("name", "")): package
        for library in board.iter("library")
        for package in library.iter("package")
    }
    reader = _Reader(path)
    parts = []
    for element in next(board.iter("elements"), Element("elements")):
        package = packages.get((element.get("library", ""), element.get("package", "")))
        parts.append(reader.part(element, package))
    plain = board.find("plain")
    contours, stray = join(reader.drawing(plain, _DIMENSION) if plain is not None else ())
    sentence = f"{stray} lines of layer 20 close no contour; they were left out."
    notes = (Note("lines-left-out", sentence, count=stray),) if stray else ()
    outline, *cut_outs = contours or [[]]
    return Design(path.stem, "eagle", tuple(parts), tuple(outline), tuple(map(tuple, cut_outs)), notes=notes)


class _Reader:
    def __init__(self, path: Path) -> None:
        self._path = path

    def part(self, element: Element, package: Element | None) -> Part:
        mirrored, turn = _rotation(element.get("rot", "R0"))
        box = self._body(package) if package is not None else None
        name = element.get("package", "")
        is_mark = "fiducial" in name.lower()
        populate = [a.get("value", "") for a in element.iter("attribute") if a.get("name", "").upper() == "POPULATE"]
        pads = [p for p in (package if package is not None else ()) if p.tag in ("smd", "pad")]
        sizes = [max(self._box_of_pad(p).size) for p in pads]
        return Part(
            ref=element.get("name", ""),
            side="bottom" if mirrored else "top",
            origin=(self._number(element, "x"), self._number(element, "y")),
            rotation=normalised(-turn if mirrored else turn),
            package=name,
            value=element.get("value", ""),
            box=box.mirrored() if box is not None and mirrored else box,
            fitted=not any(v.lower() in ("no", "false", "0", "dnp") for v in populate),
            is_mark=is_mark,
            mark_diameter=sizes[0] if sizes else None,
        )

    def _body(self, package: Element) -> Box | None:
        """Return the body: the documentation layer, else the silkscreen, with the pads."""
        pads = [self._box_of_pad(p) for p in package if p.tag in ("smd", "pad")]
        pins = box_around(corner for pad in pads for corner in (pad.low, pad.high))
        for layer in (_DOCUMENTATION, _PLACEMENT):
            drawn = box_around(p for piece in self.drawing(package, layer) for p in piece)
            if drawn is not None:
                return body_of(drawn, pins)
        return pins

    def _box_of_pad(self, pad: Element) -> Box:
        x, y = self._number(pad, "x"), self._number(pad, "y")
        if pad.tag == "smd":
            half = (self._number(pad, "dx") / 2, self._number(pad, "dy") / 2)
            if round(_rotation(pad.get("rot", "R0"))[1]) % 180 == 90:
                half = half[::-1]
        else:
            diameter = self._number(pad, "diameter", 0.0) or 2 * self._number(pad, "drill", 0.5)
            half = (diameter / 2, diameter / 2)
        return Box((x - half[0], y - half[1]), (x + half[0], y + half[1]))

    def drawing(self, node: Element, layer: str) -> Iterator[list[XY]]:
        """Yield lines, arcs, circles and rectangles of a layer."""
        for shape in node:
            if shape.get("layer") != layer:
                continue
            if shape.tag == "wire":
                ends = [(self._number(shape, f"x{n}"), self._number(shape, f"y{n}")) for n in (1, 2)]
                yield _arc(ends[0], ends[1], self._number(shape, "curve", 0.0))
            elif shape.tag == "circle":
                yield circle_points((self._number(shape, "x"), self._number(shape, "y")), self._number(shape, "radius"))
            elif shape.tag == "rectangle":
                x0, y0, x1, y1 = (self._number(shape, key) for key in ("x1", "y1", "x2", "y2"))
                yield [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
            elif shape.tag == "polygon":
                points = [(self._number(v, "x"), self._number(v, "y")) for v in shape.iter("vertex")]
                if points:
                    yield [*points, points[0]]

    def _number(self, element: Element, key: str, default: float | None = None) -> float:
        text = element.get(key)
        if text is None and default is not None:
            return default
        found = number_of(text)
        if found is None:
            raise InputError.field(self._path, f"{element.tag} {element.get('name', '')} {key}", text, "a number")
        return found


def _rotation(text: str) -> tuple[bool, float]:
    """Return whether a part is mirrored, and its rotation: `MR90`, `SR180` (spin)."""
    match = re.fullmatch(r"([MS]*)R(-?\d{1,9}(?:\.\d+)?)", text)
    return ("M" in match[1], float(match[2])) if match else (False, 0.0)


def _arc(start: XY, end: XY, curve: float) -> list[XY]:
    """Return an arc between two points with its angle in degrees, counter-clockwise if positive."""
    if abs(curve) < 1e-6 or math.dist(start, end) < 1e-9:
        return [start, end]
    half = math.radians(curve) / 2
    dx, dy = end[0] - start[0], end[1] - start[1]
    shift = 1 / (2 * math.tan(half))
    center = ((start[0] + end[0]) / 2 - dy * shift, (start[1] + end[1]) / 2 + dx * shift)
    return arc_points(start, end, center, clockwise=curve < 0)
