"""Read EAGLE boards (`.brd`, XML since version 6; Autodesk Fusion exports the same).

Lengths are in mm, y points up. `rot="MR90"`: rotated by 90° counter-clockwise, then mirrored in x, which is a rotation
by −90° after the mirroring. Source: eagle.dtd, which comes with EAGLE; KiCad's importer for the order.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element, tostring

from vaoi_station.board_data.contours import arc_points, circle_points, find_contours
from vaoi_station.board_data.design import (
    XY,
    Box,
    Design,
    Part,
    Placement,
    body_of,
    box_around,
    extent,
    normalised,
    noted,
    some,
)
from vaoi_station.board_data.readers.table_words import is_fitted
from vaoi_station.board_data.source_text import decode, number_of, parse_xml
from vaoi_station.errors import InputError
from vaoi_station.model.reason import Note

_DIMENSION, _DOCUMENTATION, _PLACEMENT = "20", "51", "21"
"""Numbers of the layers for the outline of the board, and for the drawing of parts."""
_DOCTYPE = re.compile(r"<!DOCTYPE\s+eagle\s+SYSTEM\s+[\"']eagle\.dtd[\"']\s*>")
_PADS = ("smd", "pad")
_FITTING = frozenset({"POPULATE", "FITTED", "DNP", "DNI", "DNF"})
"""Attributes by which users state whether a part is fitted; `populate` is EAGLE's own."""


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
    variants = [(v.get("name", ""), v.get("current") == "yes") for v in board.iterfind("variantdefs/variantdef")]
    current = next((name for name, is_current in variants if is_current), None)
    reader, libraries = _Reader(path, current), _Libraries(board)
    parts, without_pads = [], []
    edges: list[list[XY]] = []
    plain = board.find("plain")
    if plain is not None:
        edges += reader.drawing(plain, _DIMENSION)
    for element in next(board.iter("elements"), Element("elements")):
        package = libraries.package_of(element)
        part = reader.part(element, package)
        parts.append(part)
        if package is not None:
            at = Placement("M" in element.get("rot", ""), part.rotation, part.origin)
            edges += [list(map(at.apply, piece)) for piece in reader.drawing(package, _DIMENSION)]
            if not any(p.tag in _PADS for p in package):
                without_pads.append(part.ref)
    contours = find_contours(edges, "layer 20")
    notes = [*libraries.notes(), *contours.notes]
    # A board without variants may state a single, unnamed one: `<unnamed>`, or a translation of it.
    if len(variants) > 1 or any(not re.fullmatch("<.*>", name) for name, _ in variants):
        which = f"{current!r}, the current one," if current is not None else "the default one"
        names = ", ".join(name for name, _ in variants)
        sentence = f"the file has assembly variants ({names}); {which} was read."
        notes.append(Note("variant-read", sentence, names=names, variant=current or ""))
    if without_pads:
        text = "{count} parts have no pads: {names}. Remove those that are a frame or a logo."
        notes.append(noted("parts-without-pads", text, count=len(without_pads), names=without_pads))
    return Design(
        name=path.stem,
        format="eagle",
        parts=tuple(parts),
        outline=contours.outline,
        cut_outs=contours.others,
        islands=contours.islands,
        notes=tuple(notes),
    )


class _Libraries:
    """The packages of all libraries of a board.

    Since version 9 several may have one name; `urn` of the library and `library_urn` of the element distinguish them.
    An element without it is of the library without, else of the only library of its name. Names are without regard to
    case, as in EAGLE.
    """

    def __init__(self, board: Element) -> None:
        self._packages: defaultdict[tuple[str, str], list[tuple[str, Element]]] = defaultdict(list)
        self._missing: defaultdict[str, list[str]] = defaultdict(list)
        self._ambiguous: defaultdict[str, list[str]] = defaultdict(list)
        for library in board.iterfind("libraries/library"):
            for package in library.iter("package"):
                key = (library.get("name", "").casefold(), package.get("name", "").casefold())
                self._packages[key].append((library.get("urn", ""), package))

    def package_of(self, element: Element) -> Element | None:
        """Return the package of an element; None if the board has none, or several that differ."""
        library, name, urn = (element.get(key, "") for key in ("library", "package", "library_urn"))
        found = self._packages.get((library.casefold(), name.casefold()), [])
        candidates = [package for of, package in found if of == urn] or [package for _, package in found]
        if not candidates:
            self._missing[name].append(element.get("name", ""))
            return None
        # What they consist of decides, without their own attributes, such as the version of the library.
        drawn = {b"".join(tostring(child) for child in p if child.tag != "description") for p in candidates}
        if len(drawn) > 1:
            self._ambiguous[f"{name} of {library}"].append(element.get("name", ""))
            return None
        return candidates[0]

    def notes(self) -> Iterator[Note]:
        """Yield notes on packages that were not found."""
        missing, ambiguous = (
            [f"{name} ({some(refs)})" for name, refs in found.items()] for found in (self._missing, self._ambiguous)
        )
        if missing:
            text = "{count} packages are not in the file: {names}."
            yield noted("packages-not-described", text, count=len(missing), names=missing)
        if ambiguous:
            text = (
                "{count} packages are in several libraries of one name, and their elements state no library_urn of one "
                "of them; their bodies were left out: {names}."
            )
            yield noted("packages-ambiguous", text, count=len(ambiguous), names=ambiguous)


class _Reader:
    def __init__(self, path: Path, variant: str | None) -> None:
        self._path, self._variant = path, variant

    def part(self, element: Element, package: Element | None) -> Part:
        mirrored, turn = self._rotation(element)
        variant = next((v for v in element.iterfind("variant") if v.get("name") == self._variant), Element("variant"))
        value = str(variant.get("value") or element.get("value", ""))
        populate = variant.get("populate") or element.get("populate", "yes")
        stated = [a for a in element.iter("attribute") if a.get("name", "").upper() in _FITTING]
        fitted = all(is_fitted(a.get("value", ""), a.get("name", ""), "") for a in stated)
        pads = [self._box_of_pad(p) for p in (package if package is not None else ()) if p.tag in _PADS]
        box, name = self._body(package, pads) if package is not None else None, element.get("package", "")
        return Part(
            ref=element.get("name", ""),
            side="bottom" if mirrored else "top",
            origin=self._xy(element),
            rotation=normalised(-turn if mirrored else turn),
            package=name,
            value=value,
            box=box.mirrored() if box is not None and mirrored else box,
            fitted=fitted and is_fitted("", "", (value,)) and populate != "no",
            is_mark="fiducial" in name.lower(),
            mark_diameter=max(pads[0].size) if pads else None,
        )

    def _body(self, package: Element, pads: list[Box]) -> Box | None:
        """Return the body: the documentation layer, else the silkscreen, with the pads."""
        pins = box_around(corner for pad in pads for corner in (pad.low, pad.high))
        for layer in (_DOCUMENTATION, _PLACEMENT):
            drawn = box_around(p for piece in self.drawing(package, layer) for p in piece)
            if drawn is not None:
                return body_of(drawn, pins)
        return pins

    def _box_of_pad(self, pad: Element) -> Box:
        at = self._xy(pad)
        if pad.tag == "smd":
            box = Box.of_size(self._number(pad, "dx"), self._number(pad, "dy"))
        else:
            diameter = self._number(pad, "diameter", 0.0) or 2 * self._number(pad, "drill", 0.5)
            # A long pad is twice as long as wide.
            box = Box.of_size(2 * diameter if pad.get("shape") == "long" else diameter, diameter)
        return Box(*extent(box.corners(Placement(False, self._rotation(pad)[1], at))))

    def drawing(self, node: Element, layer: str) -> Iterator[list[XY]]:
        """Yield lines, arcs, circles, rectangles and polygons of a layer."""
        for shape in node:
            if shape.get("layer") != layer:
                continue
            if shape.tag == "wire":
                yield _arc(self._xy(shape, "1"), self._xy(shape, "2"), self._number(shape, "curve", 0.0))
            elif shape.tag == "circle":
                yield circle_points(self._xy(shape), self._number(shape, "radius"))
            elif shape.tag == "rectangle":
                (x0, y0), (x1, y1) = self._xy(shape, "1"), self._xy(shape, "2")
                # It is rotated about its centre.
                turned = Placement(False, self._rotation(shape)[1], ((x0 + x1) / 2, (y0 + y1) / 2))
                a, b, c, d = Box.of_size(x1 - x0, y1 - y0).corners(turned)
                yield [a, c, d, b, a]
            elif shape.tag == "polygon":
                yield self._contour(shape)
            elif shape.tag == "polygonshape":  # version 9.7; its children are contours, such as polygonoutlinesegments
                yield from map(self._contour, shape)

    def _contour(self, polygon: Element) -> list[XY]:
        """Return the points of a polygon; `curve` of a vertex is that of the edge from it to the next one."""
        vertices = polygon.findall("vertex")
        points = [self._xy(v) for v in vertices]
        found = points[:1]
        for vertex, start, end in zip(vertices, points, [*points[1:], *points[:1]], strict=True):
            found += _arc(start, end, self._number(vertex, "curve", 0.0))[1:]
        return found

    def _rotation(self, element: Element) -> tuple[bool, float]:
        """Return whether a part is mirrored, and its rotation: `MR90`, `SR180` (spin, which turns its texts only)."""
        text = element.get("rot", "R0")
        match = re.fullmatch(r"([MS]{0,2})R(.+)", text)
        degrees = number_of(match[2]) if match else None
        if match is None or degrees is None:
            where = f"{element.tag} {element.get('name', '')} rot"
            raise InputError.field(self._path, where, text, "R and degrees, such as R90, MR90 or MSR90")
        return "M" in match[1], degrees

    def _xy(self, element: Element, suffix: str = "") -> XY:
        return self._number(element, f"x{suffix}"), self._number(element, f"y{suffix}")

    def _number(self, element: Element, key: str, default: float | None = None) -> float:
        text = element.get(key)
        found = default if text is None else number_of(text)
        if found is None:
            raise InputError.field(self._path, f"{element.tag} {element.get('name', '')} {key}", text, "a number")
        return found


def _arc(start: XY, end: XY, curve: float) -> list[XY]:
    """Return an arc between two points with its angle in degrees, counter-clockwise if positive."""
    if abs(curve) < 1e-6 or math.dist(start, end) < 1e-9:
        return [start, end]
    dx, dy, shift = end[0] - start[0], end[1] - start[1], 1 / (2 * math.tan(math.radians(curve) / 2))
    center = ((start[0] + end[0]) / 2 - dy * shift, (start[1] + end[1]) / 2 + dx * shift)
    return arc_points(start, end, center, clockwise=curve < 0)
