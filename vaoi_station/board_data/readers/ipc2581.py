"""Read IPC-2581 files, revisions A to C.

Packages are drawn as seen from the side of the part; on the bottom they are turned, then mirrored in x. KiCad 9 draws
them as seen from the top. Pads that name component and pin show which rule holds (`pin_rules`); logical and
physical nets state no places of pins. Source: IPC-2581C and its schema.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterator
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
    NetPoint,
    Part,
    Placement,
    PointKind,
    Side,
    box_around,
    noted,
)
from vaoi_station.board_data.net_points import Openings, numbered, unmasked
from vaoi_station.board_data.panels import Repeat, Step, note_on_panels, panel_of
from vaoi_station.board_data.panels.step_and_repeat import stated_count
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
_COPPER = ("CONDUCTOR", "SIGNAL", "PLANE", "MIXED", "CONDFILM", "CONDFOIL")
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
    steps = {_local(element.get("name")): element for element in reversed(list(root.iter("Step")))}
    placed, panels = (
        [name for name, element in reversed(steps.items()) if element.find(tag) is not None]
        for tag in ("Component", "StepRepeat")
    )
    known = tuple(name for name in reversed(steps) if name in placed or name in panels)
    if step is not None and step not in known:
        limit = f"a step with components or repeats: {', '.join(known) or 'there is none'}"
        raise InputError.field(path, "--step", step, limit)
    if not placed:
        raise InputError(f"{path}: no step has a component; the file is no assembly data. Export it with components.")
    reader = _Reader(path, root, _UNITS[unit])
    if step is not None:

        def read(name: str) -> Step:
            if name not in steps:
                raise InputError(f"{path}: a panel repeats step {name!r}, which the file does not have.")
            return reader.step(steps[name], name)

        design = panel_of(step, read, str(path))
    else:
        best = max(placed, key=lambda name: len(steps[name].findall("Component")))
        design = reader.design(steps[best], best)
        if len(placed) > 1:
            text = f"the file has {len(placed)} steps with components ({{names}}); {{step}} was read. Choose by --step."
            design = design.with_notes(noted("several-steps", text, names=", ".join(placed), step=best))
        design = design.with_notes(*note_on_panels([name for name in panels if name != best]))
    return replace(design, name=design.name or path.stem, step=design.name, steps=known)


@dataclass(frozen=True)
class _Package:
    name: str
    drawing: Box | None = None
    pads: Box | None = None
    height: float | None = None
    pad: float | None = None
    """Largest extent of its first pad."""
    pins: tuple[tuple[str, XY], ...] = ()
    """Number and place of every pin."""


class _Reader:
    def __init__(self, path: Path, root: Element, mm: float) -> None:
        self._path, self._mm = path, mm
        sides: dict[str, Side] = {"TOP": "top", "BOTTOM": "bottom"}
        layers = [(layer.get("name", ""), layer.get("side", "").upper()) for layer in root.iter("Layer")]
        self._sides = {name: sides[side] for name, side in layers if side in sides}
        """Side of each outer layer."""
        self._functions = {e.get("name", ""): e.get("layerFunction", "").upper() for e in root.iter("Layer")}
        self._sizes: dict[str, float | None] = {}
        """Smallest extents of pads by the primitive that they name."""
        self._primitives = {e.get("id", ""): e for tag in ("EntryStandard", "EntryUser") for e in root.iter(tag)}
        self._boms = [element for element in root.iter("Bom") if next(element.iter("RefDes"), None) is not None]
        chosen = [element.get("name", "") for content in root.iter("Content") for element in content.iter("BomRef")]
        # Those that the content names come first, in its order.
        self._boms.sort(key=lambda bom: chosen.index(bom.get("name", "")) if bom.get("name") in chosen else len(chosen))
        self._by_kicad = any("kicad" in (e.get("name") or "").lower() for e in root.iter("SoftwarePackage"))

    def step(self, step: Element, name: str) -> Step:
        """Return a step with what it repeats."""
        datum = step.find("Datum")
        repeats = tuple(self._repeat(element) for element in step.findall("StepRepeat"))
        return Step(self.design(step, name), lambda: (0.0, 0.0) if datum is None else self._xy(datum), repeats)

    def _repeat(self, element: Element) -> Repeat:
        """Return a block of step-and-repeat: the datum of the step at x, y, mirrored in x first, then turned."""
        count = [stated_count(self._path, element.attrib, key, f"{element.tag} {key}") for key in ("nx", "ny")]
        return Repeat(
            step=_local(element.get("stepRef")),
            first=(self._mm * self._number(element, "x", 0.0), self._mm * self._number(element, "y", 0.0)),
            pitch=(self._mm * self._number(element, "dx", 0.0), self._mm * self._number(element, "dy", 0.0)),
            counts=(count[0], count[1]),
            degrees=self._number(element, "angle", 0.0),
            mirrored=_is_mirrored(element),
        )

    def design(self, step: Element, name: str) -> Design:
        """Return a step without what it repeats. Wrong values of its datum and repeats change no board."""
        packages = {p.get("name", ""): self._package(p) for p in step.iter("Package")}
        places: defaultdict[tuple[str, str], dict[XY, None]] = defaultdict(dict)
        for pad in step.iter("Pad"):
            if (location := pad.find("Location")) is not None:
                for pin in pad.findall("PinRef"):
                    places[pin.get("componentRef", ""), pin.get("pin", "")][self._xy(location)] = None
        not_fitted, notes_on_boms = self._not_fitted(name)
        components = step.findall("Component")
        absent = {ref for c in components if (ref := c.get("packageRef", "")) not in packages}
        drawn = []
        for component in components:
            ref = component.get("packageRef", "")
            package = packages.get(ref) or _Package(_plain(ref))
            drawn.append(self._part(component, package, places, not_fitted))
        parts, notes = placed_parts(drawn, self._usual_rule)
        notes += notes_on_boms
        if absent:
            text = "{count} packages are not described: {names}."
            notes.append(noted("packages-not-described", text, count=len(absent), names=", ".join(sorted(absent)[:8])))
        # Pins of another datum than the parts would lie beside the board.
        moved = any(note.code == "pins-of-other-datum" for note in notes)
        points, notes_on_mask = ([], []) if moved else self._net_points(step)
        notes += notes_on_mask
        profile = step.find("Profile")
        outline = self._polygon(profile.find("Polygon")) if profile is not None else []
        cut_outs = [self._polygon(c) for c in profile.iter("Cutout")] if profile is not None else []
        return Design(
            name,
            "ipc2581",
            tuple(parts),
            tuple(outline),
            tuple(map(tuple, cut_outs)),
            marks=tuple(self._marks(step)),
            net_points=numbered(points),
            notes=tuple(notes),
        )

    def _not_fitted(self, step: str) -> tuple[set[str], list[Note]]:
        """Return the designators of a step that are not populated; of bills of the same designators by the first one.

        Bills of different designators, such as of both sides, belong together.
        """
        steps = [[_local(ref.get("name")) for ref in bom.iterfind("BomHeader/StepRef")] for bom in self._boms]
        boms = [bom for bom, names in zip(self._boms, steps, strict=True) if not names or step in names] or self._boms
        refs = [{ref.get("name", "") for ref in bom.iter("RefDes")} for bom in boms]
        notes = []
        if sum(map(len, refs)) > len(set().union(*refs)):
            names = [_local(bom.get("name")) for bom in boms]
            text = (
                "the file has several bills of materials for the same parts ({names}); {bom} was read. By another one "
                "other parts may be fitted."
            )
            notes.append(noted("bom-read", text, names=", ".join(names), bom=names[0]))
            boms = boms[:1]
        all_refs = (ref for bom in boms for ref in bom.iter("RefDes"))
        return {_plain(r.get("name", "")) for r in all_refs if r.get("populate", "true").lower() == "false"}, notes

    def _usual_rule(self, side: Side, word: str) -> Rule:
        if side == "top" and word != "mirror":
            return Rule(mirrored=False, sign=1)
        return Rule(False, -1, 180.0) if self._by_kicad else Rule(mirrored=True, sign=-1)

    def _part(
        self,
        component: Element,
        package: _Package,
        places: dict[tuple[str, str], dict[XY, None]],
        not_fitted: set[str],
    ) -> DrawnPart:
        key = component.get("refDes", "")
        ref, transform, location = _plain(key), component.find("Xform"), component.find("Location")
        if not ref or location is None:
            raise InputError(f"{self._path}: a Component has no refDes or no Location (refDes {ref!r}).")
        mirror = _is_mirrored(transform)
        part = Part(
            ref=ref,
            # Of a rigid-flex board parts may lie on inner layers; those that are mirrored are seen from below.
            side=self._sides.get(component.get("layerRef", ""), "bottom" if mirror else "top"),
            origin=self._xy(location),
            rotation=self._number(transform, "rotation", 0.0),
            package=package.name,
            value=_plain(component.get("part", "")),
            box=package.drawing,
            body_height=package.height,
            fitted=ref not in not_fitted,
            is_mark="fiducial" in package.name.lower(),
            mark_diameter=package.pad,
        )
        numbers = Counter(number for number, _ in package.pins)
        # Pins of one number, such as the pads of a tab, may lie at any place of that number.
        pins = tuple(
            Pin(at, tuple(places[key, number]))
            for number, at in package.pins
            if (key, number) in places and (numbers[number] == 1 or len(places[key, number]) > 1)
        )
        return DrawnPart(part, (pins,), "mirror" if mirror else "", package.pads, pads_count=True)

    def _package(self, element: Element) -> _Package:
        outline, assembly = element.find("Outline"), element.find("AssemblyDrawing")
        points = [p for shape in (outline if outline is not None else ()) for p in self._points(shape)]
        drawn = [p for shape in (assembly.iter() if assembly is not None else ()) for p in self._points(shape)]
        pads = [self._pad(pin) for pin in element.findall("Pin")]
        first = box_around(pads[0]) if pads else None
        places = tuple(
            (pin.get("number", ""), self._xy(location))
            for pin in element.findall("Pin")
            if (location := pin.find("Location")) is not None
        )
        return _Package(
            name=_plain(element.get("name", "")),
            drawing=box_around(drawn) or box_around(points),
            pads=box_around(p for pad in pads for p in pad),
            height=self._number(element, "height", 0.0) * self._mm or None,
            pad=max(first.size) if first else None,
            pins=places,
        )

    def _pad(self, pin: Element) -> list[XY]:
        if (location := pin.find("Location")) is None:
            return []
        at = Placement(False, self._number(pin.find("Xform"), "rotation", 0.0), self._xy(location))
        shapes = (child for child in pin if child.tag not in ("Location", "Xform"))
        return [at.apply(p) for shape in shapes for p in self._points(shape)] or [at.shift]

    def _points(self, shape: Element) -> list[XY]:
        """Return the corners of a shape; of a reference, those of the primitive that it names."""
        if shape.tag in ("Polygon", "Polyline", "Contour", "Cutout"):
            return self._polygon(shape)
        if shape.tag in ("StandardPrimitiveRef", "UserPrimitiveRef"):
            entry = self._primitives.get(shape.get("id", ""))
            return [p for child in (entry if entry is not None else ()) for p in self._points(child)]
        if shape.tag == "Circle":
            return circle_points((0.0, 0.0), max(0.0, self._number(shape, "diameter")) * self._mm / 2)
        if shape.tag == "Line":
            return [self._xy(shape, "startX", "startY"), self._xy(shape, "endX", "endY")]
        if shape.get("width") and shape.get("height"):
            return Box.of_size(*(max(0.0, size) for size in self._xy(shape, "width", "height"))).corners(Placement())
        return []

    def _polygon(self, element: Element | None) -> list[XY]:
        points: list[XY] = []
        for step in element if element is not None else ():
            if step.tag == "Polygon":
                points += self._polygon(step)
            elif step.tag == "PolyStepCurve" and points:
                center, clockwise = self._xy(step, "centerX", "centerY"), step.get("clockwise", "false") == "true"
                points += arc_points(points[-1], self._xy(step), center, clockwise)[1:]
            elif step.tag in ("PolyBegin", "PolyStepSegment", "PolyStepCurve"):
                points.append(self._xy(step))
        return points[:-1] if len(points) > 1 and math.dist(points[0], points[-1]) < 1e-6 else points

    def _marks(self, step: Element) -> Iterator[Mark]:
        for layer in step.findall("LayerFeature"):
            side = self._sides.get(layer.get("layerRef", ""))
            for tag, kind in _MARK_KINDS.items():
                for n, mark in enumerate(layer.iter(tag), 1):
                    if (location := mark.find("Location")) is not None:
                        box = box_around(p for shape in mark for p in self._points(shape))
                        size = max(box.size) if box else None
                        of = {_plain(pin.get("componentRef", "")) for pin in mark.iter("PinRef")} - {""}
                        yield Mark(f"{tag}{n}", side, self._xy(location), size, kind, components=tuple(sorted(of)))

    def _net_points(self, step: Element) -> tuple[list[NetPoint], list[Note]]:
        """Return the pads of parts, and the vias, on the outer conductors, and notes on their mask."""
        holes = (hole for hole in step.iter("Hole") if hole.get("platingStatus") == "VIA")
        drilled = Openings(at for hole in holes if (at := self._sound_xy(hole)) is not None)
        masks: dict[Side, list[XY]] = {}
        found: dict[tuple[str, str, XY], NetPoint] = {}
        for layer in step.findall("LayerFeature"):
            name = layer.get("layerRef", "")
            if (side := self._sides.get(name)) is None or self._functions[name] not in (*_COPPER, "SOLDERMASK"):
                continue
            for of in layer.findall("Set"):
                of_via, net = of.get("padUsage") == "VIA", _bare(of.get("net", ""))
                for pad in of.iter("Pad"):
                    location = pad.find("Location")
                    if location is None or (at := self._sound_xy(location)) is None:
                        continue
                    if self._functions[name] == "SOLDERMASK":
                        masks.setdefault(side, []).append(at)
                        continue
                    pin = pad.find("PinRef")
                    ref, number = (
                        ("", "") if pin is None else map(_bare, (pin.get("componentRef", ""), pin.get("pin", "")))
                    )
                    if pin is None and not of_via and at not in drilled:
                        continue
                    key = ref, number, (round(at[0], 3), round(at[1], 3))
                    known = found.get(key) or NetPoint(ref, number, net, at, False, False, "pad" if ref else "via")
                    kind: PointKind = "pin" if ref and (known.on_top or known.on_bottom) else known.kind
                    size = known.diameter or self._smallest(pad)
                    top, bottom = known.on_top or side == "top", known.on_bottom or side == "bottom"
                    found[key] = known._replace(kind=kind, diameter=size, on_top=top, on_bottom=bottom)
        return unmasked(found.values(), {side: Openings(places) for side, places in masks.items()})

    def _smallest(self, pad: Element) -> float | None:
        """Return the smallest extent of a pad, mm; None if it is not stated."""
        key = next((shape.get("id", "") for shape in pad if shape.tag.endswith("PrimitiveRef")), "")
        if key not in self._sizes:
            try:
                box = box_around(p for shape in pad for p in self._points(shape))
            except InputError:
                box = None
            self._sizes[key] = min(box.size) if box else None
        return self._sizes[key]

    def _sound_xy(self, element: Element) -> XY | None:
        """Return a place; None if it is not stated: pads and vias refuse no file."""
        x, y = number_of(element.get("x")), number_of(element.get("y"))
        return None if x is None or y is None else (x * self._mm, y * self._mm)

    def _xy(self, element: Element, x: str = "x", y: str = "y") -> XY:
        return self._number(element, x) * self._mm, self._number(element, y) * self._mm

    def _number(self, element: Element | None, key: str, default: float | None = None) -> float:
        text = None if element is None else element.get(key)
        found = default if text is None else number_of(text)
        if found is None:
            raise InputError.field(self._path, f"{'' if element is None else element.tag} {key}", text, "a number")
        return found


def _is_mirrored(element: Element | None) -> bool:
    return element is not None and element.get("mirror", "false").lower() in ("true", "1")


def _bare(name: str) -> str:
    """Return the name of a part, pin or net without the prefix of its kind."""
    return name.partition(":")[2] if name.partition(":")[0] in ("CMP", "PIN", "NET") else name


def _local(name: str | None) -> str:
    """Return the name of a step or bill without the prefix of its kind."""
    return (name or "").rpartition(":")[2]


def _plain(name: str) -> str:
    """Return a name without the prefix of its kind, which KiCad puts before a colon."""
    return name.partition(":")[2] if name.partition(":")[0] in ("CMP", "KI", "REF", "BOARD", "LAYER") else name
