"""Read IPC-2581 files, revisions A to C.

Packages are drawn as seen from the side of the part; on the bottom they are turned, then mirrored in x. KiCad 9 draws
them as seen from the top. Pads that name component and pin show which rule holds (`pin_rules`); logical and
physical nets state no places of pins. Source: IPC-2581C and its schema.
"""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element

from vaoi_station.board_data.contours import arc_points, circle_points
from vaoi_station.board_data.design import (
    XY,
    Box,
    Design,
    Mark,
    MarkKind,
    Part,
    Side,
    box_around,
    rotated,
)
from vaoi_station.board_data.panels import Repeat, Step, note_on_panels, panel_of
from vaoi_station.board_data.pin_rules import DrawnPart, Pin, Rule, placed_parts
from vaoi_station.board_data.source_text import number_of, parse_xml
from vaoi_station.errors import InputError
from vaoi_station.model.reason import Note

_MARK_KINDS: dict[str, MarkKind] = {
    "GlobalFiducial": "global",
    "LocalFiducial": "local",
    "GoodPanelMark": "panel",
    "BadBoardMark": "bad-board",
}
_UNITS = {"MILLIMETER": 1.0, "MICRON": 0.001, "INCH": 25.4}


def is_ipc2581(head: bytes) -> bool:
    """Return whether a file begins like an IPC-2581 file."""
    return b"<IPC-2581" in head


def read_ipc2581(data: bytes, path: Path, step: str | None = None) -> Design:
    """Read one step of an IPC-2581 file; by default the one with most components, the first of equals.

    A panel has its boards, which are not laid out yet.
    """
    root = parse_xml(data, path)
    if root.tag != "IPC-2581":
        raise InputError(f"{path}: its first element is <{root.tag}>, that of an IPC-2581 file is <IPC-2581>.")
    header = next(root.iter("CadHeader"), None)
    unit = "" if header is None else header.get("units", "")
    if unit not in _UNITS:
        raise InputError.field(path, "CadHeader units", unit, ", ".join(_UNITS))
    steps = {_step_name(element): element for element in reversed(list(root.iter("Step")))}
    placed = [name for name, element in steps.items() if element.find("Component") is not None][::-1]
    panels = [name for name, element in steps.items() if element.find("StepRepeat") is not None][::-1]
    known = tuple(name for name in reversed(steps) if name in placed or name in panels)
    if step is not None and step not in known:
        limit = f"a step with components or repeats: {', '.join(known) or 'there is none'}"
        raise InputError.field(path, "--step", step, limit)
    if not placed:
        raise InputError(f"{path}: no step has a component; the file is no assembly data. Export it with components.")
    reader = _Reader(path, root, _UNITS[unit])
    notes = []
    if step is None:
        best = max(placed, key=lambda name: len(steps[name].findall("Component")))
        design = reader.design(steps[best], best)
        if len(placed) > 1:
            names = ", ".join(placed)
            sentence = f"the file has {len(placed)} steps with components ({names}); {best} was read. Choose by --step."
            notes.append(Note("several-steps", sentence, names=names, step=best))
        notes += note_on_panels([name for name in panels if name != best])
    else:

        def read(name: str) -> Step:
            if name not in steps:
                raise InputError(f"{path}: a panel repeats step {name!r}, which the file does not have.")
            return reader.step(steps[name], name)

        design = panel_of(step, read, str(path))
    design = design.with_notes(*notes)
    return replace(design, name=design.name or path.stem, step=design.name, steps=known)


def _step_name(element: Element) -> str:
    """Return the name of a step without the prefix of its kind."""
    return element.get("name", "").rpartition(":")[2]


@dataclass
class _Package:
    drawing: Box | None
    pads: Box | None
    height: float | None
    name: str
    pad: float | None
    """Largest extent of its first pad."""
    pins: tuple[tuple[str, XY], ...]
    """Number and place of every pin."""


class _Reader:
    def __init__(self, path: Path, root: Element, mm: float) -> None:
        self._path, self._root, self._mm = path, root, mm
        self._sides, self._primitives = _sides(root), _primitives(root)
        self._boms = [element for element in root.iter("Bom") if next(element.iter("RefDes"), None) is not None]
        chosen = [element.get("name", "") for content in root.iter("Content") for element in content.iter("BomRef")]
        # Those that the content names come first, in its order.
        self._boms.sort(key=lambda bom: chosen.index(bom.get("name", "")) if bom.get("name") in chosen else len(chosen))
        self._by_kicad = any("kicad" in (e.get("name") or "").lower() for e in root.iter("SoftwarePackage"))

    def step(self, step: Element, name: str) -> Step:
        """Return a step with what it repeats."""

        def datum() -> XY:
            element = step.find("Datum")
            return (0.0, 0.0) if element is None else self._place(element)

        repeats = tuple(self._repeat(element) for element in step.findall("StepRepeat"))
        return Step(self.design(step, name), datum, repeats)

    def _repeat(self, element: Element) -> Repeat:
        """Return a block of step-and-repeat: the datum of the step at x, y, mirrored in x first, then turned."""
        mm = self._mm
        return Repeat(
            step=element.get("stepRef", "").rpartition(":")[2],
            first=(self._number(element, "x", 0.0) * mm, self._number(element, "y", 0.0) * mm),
            pitch=(self._number(element, "dx", 0.0) * mm, self._number(element, "dy", 0.0) * mm),
            counts=(self._count(element, "nx"), self._count(element, "ny")),
            degrees=self._number(element, "angle", 0.0),
            mirrored=element.get("mirror", "false").lower() in ("true", "1"),
        )

    def _count(self, element: Element, key: str) -> int:
        text = element.get(key, "1")
        if not re.fullmatch(r"\d{1,9}", text):
            raise InputError.field(self._path, f"{element.tag} {key}", text, "a whole number from 1")
        return int(text)

    def design(self, step: Element, name: str) -> Design:
        """Return a step without what it repeats. Wrong values of its datum and repeats change no board."""
        packages = {p.get("name", ""): self._package(p) for p in step.iter("Package")}
        places = self._pin_places(step)
        not_fitted, notes_on_boms = self._not_fitted(name)
        drawn, absent = [], set()
        for component in step.findall("Component"):
            package = packages.get(component.get("packageRef", ""))
            if package is None:
                absent.add(component.get("packageRef", ""))
            drawn.append(self._part(component, package, places, not_fitted))
        parts, notes = placed_parts(drawn, self._usual_rule)
        notes += notes_on_boms
        if absent:
            names = ", ".join(sorted(absent)[:8])
            sentence = f"{len(absent)} packages are not described: {names}."
            notes.append(Note("packages-not-described", sentence, count=len(absent), names=names))
        profile = step.find("Profile")
        outline = self._polygon(profile.find("Polygon")) if profile is not None else []
        cut_outs = [self._polygon(c) for c in profile.iter("Cutout")] if profile is not None else []
        marks = tuple(self._marks(step))
        return Design(
            name, "ipc2581", tuple(parts), tuple(outline), tuple(map(tuple, cut_outs)), marks=marks, notes=tuple(notes)
        )

    def _not_fitted(self, step: str) -> tuple[set[str], list[Note]]:
        """Return the designators of a step that are not populated; of bills of the same designators by the first one.

        Bills of different designators, such as of both sides, belong together.
        """
        steps = [[_step_name(ref) for ref in bom.iterfind("BomHeader/StepRef")] for bom in self._boms]
        boms = [bom for bom, names in zip(self._boms, steps, strict=True) if not names or step in names] or self._boms
        refs = [{ref.get("name", "") for ref in bom.iter("RefDes")} for bom in boms]
        notes = []
        if sum(map(len, refs)) > len(set().union(*refs)):
            names = ", ".join(bom.get("name", "").rpartition(":")[2] for bom in boms)
            first = boms[0].get("name", "").rpartition(":")[2]
            sentence = (
                f"the file has several bills of materials for the same parts ({names}); {first} was read. By "
                "another one other parts may be fitted."
            )
            notes.append(Note("bom-read", sentence, names=names, bom=first))
            boms = boms[:1]
        return {
            _plain(ref.get("name", ""))
            for bom in boms
            for ref in bom.iter("RefDes")
            if ref.get("populate", "true").lower() == "false"
        }, notes

    def _usual_rule(self, side: Side, word: str) -> Rule:
        if side == "top" and word != "mirror":
            return Rule(mirrored=False, sign=1)
        return Rule(False, -1, 180.0) if self._by_kicad else Rule(mirrored=True, sign=-1)

    def _part(
        self,
        component: Element,
        package: _Package | None,
        places: Mapping[tuple[str, str], tuple[XY, ...]],
        not_fitted: Set[str],
    ) -> DrawnPart:
        ref = _plain(component.get("refDes", ""))
        transform, location = component.find("Xform"), component.find("Location")
        if not ref or location is None:
            raise InputError(f"{self._path}: a Component has no refDes or no Location (refDes {ref!r}).")
        mirror = transform is not None and transform.get("mirror", "false").lower() in ("true", "1")
        # Of a rigid-flex board parts may lie on inner layers; those that are mirrored are seen from below.
        side = self._sides.get(component.get("layerRef", ""), "bottom" if mirror else "top")
        name = package.name if package else _plain(component.get("packageRef", ""))
        is_mark = "fiducial" in name.lower()
        part = Part(
            ref=ref,
            side=side,
            origin=self._place(location),
            rotation=self._number(transform, "rotation", 0.0),
            package=name,
            value=_plain(component.get("part", "")),
            box=package.drawing if package else None,
            body_height=package.height if package else None,
            fitted=ref not in not_fitted,
            is_mark=is_mark,
            mark_diameter=package.pad if package else None,
        )
        key = component.get("refDes", "")
        numbers = Counter(number for number, _ in package.pins) if package else {}
        # Pins of one number, such as the pads of a tab, may lie at any place of that number.
        pins = tuple(
            Pin(at, places[key, number])
            for number, at in (package.pins if package else ())
            if (key, number) in places and (numbers[number] == 1 or len(places[key, number]) > 1)
        )
        return DrawnPart(part, (pins,), "mirror" if mirror else "", package.pads if package else None, pads_count=True)

    def _package(self, element: Element) -> _Package:
        outline = element.find("Outline")
        points = [p for shape in (outline if outline is not None else ()) for p in self._points(shape)]
        assembly = element.find("AssemblyDrawing")
        drawn = [p for shape in (assembly.iter() if assembly is not None else ()) for p in self._points(shape)]
        pads = [self._pad(pin) for pin in element.findall("Pin")]
        pins = box_around(p for pad in pads for p in pad)
        drawing = box_around(drawn) or box_around(points)
        first = box_around(pads[0]) if pads else None
        height = self._number(element, "height", 0.0) * self._mm
        places = tuple(
            (pin.get("number", ""), self._place(location))
            for pin in element.findall("Pin")
            if (location := pin.find("Location")) is not None
        )
        pad = max(first.size) if first else None
        return _Package(drawing, pins, height or None, _plain(element.get("name", "")), pad, places)

    def _place(self, location: Element) -> XY:
        return self._number(location, "x") * self._mm, self._number(location, "y") * self._mm

    def _pin_places(self, step: Element) -> dict[tuple[str, str], tuple[XY, ...]]:
        """Return component and pin → places of its pads, on any layer."""
        found: defaultdict[tuple[str, str], dict[XY, None]] = defaultdict(dict)
        for pad in step.iter("Pad"):
            location = pad.find("Location")
            if location is None:
                continue
            for pin in pad.findall("PinRef"):
                found[pin.get("componentRef", ""), pin.get("pin", "")][self._place(location)] = None
        return {pin: tuple(places) for pin, places in found.items()}

    def _pad(self, pin: Element) -> list[XY]:
        location, transform = pin.find("Location"), pin.find("Xform")
        shapes = [child for child in pin if child.tag not in ("Location", "Xform")]
        if location is None:
            return []
        turn = self._number(transform, "rotation", 0.0)
        at = (self._number(location, "x") * self._mm, self._number(location, "y") * self._mm)
        turned = [rotated(p, turn) for shape in shapes for p in self._points(shape)]
        return [(at[0] + x, at[1] + y) for x, y in turned] or [at]

    def _points(self, shape: Element) -> list[XY]:
        """Return the corners of a shape; of a reference, those of the primitive that it names."""
        if shape.tag in ("Polygon", "Polyline", "Contour", "Cutout"):
            return self._polygon(shape)
        if shape.tag in ("StandardPrimitiveRef", "UserPrimitiveRef"):
            entry = self._primitives.get(shape.get("id", ""))
            return [p for child in (entry if entry is not None else ()) for p in self._points(child)]
        if shape.tag == "Circle":
            return circle_points((0.0, 0.0), self._number(shape, "diameter") * self._mm / 2)
        if shape.tag == "Line":
            keys = (("startX", "startY"), ("endX", "endY"))
            return [(self._number(shape, x) * self._mm, self._number(shape, y) * self._mm) for x, y in keys]
        if shape.get("width") and shape.get("height"):
            w, h = (self._number(shape, key) * self._mm / 2 for key in ("width", "height"))
            return [(-w, -h), (w, -h), (w, h), (-w, h)]
        return []

    def _polygon(self, element: Element | None) -> list[XY]:
        """Return the corners of a polygon, arcs as lines."""
        points: list[XY] = []
        for step in element if element is not None else ():
            if step.tag == "Polygon":
                points += self._polygon(step)
            elif step.tag in ("PolyBegin", "PolyStepSegment", "PolyStepCurve"):
                at = (self._number(step, "x") * self._mm, self._number(step, "y") * self._mm)
                if step.tag == "PolyStepCurve" and points:
                    center = (self._number(step, "centerX") * self._mm, self._number(step, "centerY") * self._mm)
                    points += arc_points(points[-1], at, center, step.get("clockwise", "false") == "true")[1:]
                else:
                    points.append(at)
        return points[:-1] if len(points) > 1 and math.dist(points[0], points[-1]) < 1e-6 else points

    def _marks(self, step: Element) -> Iterator[Mark]:
        """Yield the explicit fiducials and marks of a step."""
        for layer in step.findall("LayerFeature"):
            side = self._sides.get(layer.get("layerRef", ""))
            for tag, kind in _MARK_KINDS.items():
                for n, mark in enumerate(layer.iter(tag)):
                    location = mark.find("Location")
                    if location is not None:
                        box = box_around(p for shape in mark for p in self._points(shape))
                        of = {_plain(pin.get("componentRef", "")) for pin in mark.iter("PinRef")} - {""}
                        name, size = f"{tag}{n + 1}", max(box.size) if box else None
                        yield Mark(name, side, self._place(location), size, kind, components=tuple(sorted(of)))

    def _number(self, element: Element | None, key: str, default: float | None = None) -> float:
        text = None if element is None else element.get(key)
        if text is None and default is not None:
            return default
        found = number_of(text)
        if found is None:
            tag = "" if element is None else element.tag
            raise InputError.field(self._path, f"{tag} {key}", text, "a number")
        return found


def _sides(root: Element) -> dict[str, Side]:
    """Return layer → its side, for outer layers."""
    found: dict[str, Side] = {}
    for layer in root.iter("Layer"):
        side = layer.get("side", "").upper()
        if side in ("TOP", "BOTTOM"):
            found[layer.get("name", "")] = "top" if side == "TOP" else "bottom"
    return found


def _primitives(root: Element) -> dict[str, Element]:
    """Return id → entry of the dictionaries of shapes."""
    return {entry.get("id", ""): entry for tag in ("EntryStandard", "EntryUser") for entry in root.iter(tag)}


def _plain(name: str) -> str:
    """Return a name without the prefix of its kind, which KiCad puts before a colon."""
    return name.partition(":")[2] if name.partition(":")[0] in ("CMP", "KI", "REF", "BOARD", "LAYER") else name
