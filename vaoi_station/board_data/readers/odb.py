"""Read ODB++ designs, versions 7 and 8, as a folder, a zip file or a tar file.

A package is drawn as seen from the side of the part, and turns clockwise as seen from there: a part on the bottom is
mirrored in x, then turned counter-clockwise as seen from the top. KiCad draws packages on the bottom as seen from the
top, and turns them clockwise. Toeprints, the places of pins, show which rule holds (`pin_rules`). Every file states a
unit. Source: ODB++ specification 8.1 and designs of Allegro, Altium, PADS, Xpedition and KiCad.
"""

from __future__ import annotations

import gzip
import io
import re
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

from vaoi_station.board_data.contours import arc_points, area
from vaoi_station.board_data.design import (
    XY,
    Contour,
    Design,
    Mark,
    NetPoint,
    Part,
    PointKind,
    Side,
    box_around,
    noted,
    places,
)
from vaoi_station.board_data.net_points import Openings, numbered, unmasked
from vaoi_station.board_data.panels import Step, note_on_panels, panel_of
from vaoi_station.board_data.pin_rules import DrawnPart, Rule, placed_parts
from vaoi_station.board_data.readers import unix_compress
from vaoi_station.board_data.readers.odb_files import (
    UNITS,
    Copper,
    OdbFile,
    Package,
    Pad,
    Toeprint,
    attributes_of,
    copper_of,
    datum_of,
    has_repeats,
    mask_layers,
    outer_layers,
    outline_points,
    packages_of,
    pad_marks,
    placed_pads,
    readings,
    repeats_of,
    toeprint_of,
)
from vaoi_station.board_data.source_text import (
    MOST_BYTES,
    Archive,
    decode,
    names_before_damage,
    number_of,
    open_archive,
)
from vaoi_station.errors import InputError
from vaoi_station.geometry.polygon import encloses
from vaoi_station.model.reason import Note

_MARK_ATTRIBUTES = (".fiducial_name", ".fiducial_rotation")
_LAYERS: tuple[tuple[Side, str], ...] = (("top", "comp_+_top"), ("bottom", "comp_+_bot"))
_MATRIX = re.compile(r"((?:.*?/)?)matrix/matrix(\.g?z)?$")


def is_odb(path: Path) -> bool:
    """Return whether a folder or an archive has the structure of an ODB++ design."""
    try:
        with open_archive(path) as archive:
            return any(_MATRIX.match(name) for name in archive.members)
    except InputError:
        # Of a damaged archive the names before the damage show what it was; `read_odb` then refuses it as damaged.
        return any(re.search(r"(^|/)(matrix|steps|symbols|misc|fonts)/", name) for name in names_before_damage(path))


def read_odb(path: Path, step: str | None = None) -> Design:
    """Read one step of an ODB++ design; by default the only one, or the one with most components.

    A panel has its boards, which are not laid out yet.
    """
    with open_archive(path) as archive:
        job = _Job(archive)
        placed = [s for s in job.steps if any(job.has(f"steps/{s}/layers/{layer}/components") for _, layer in _LAYERS)]
        panels = [s for s in job.steps if job.repeats_steps(s)]
        known = tuple(s for s in job.steps if s in placed or s in panels)
        if step is not None and step.lower() not in known:
            limit = f"a step with components or repeats: {', '.join(known) or 'there is none'}"
            raise InputError.field(path, "--step", step, limit)
        if not placed:
            raise InputError(
                f"{path}: no step has components (steps: {', '.join(job.steps) or 'none'}). "
                "Export the design with component layers comp_+_top and comp_+_bot."
            )
        if step is not None:
            best = panel_of(step.lower(), job.step, str(path))
        else:
            # A panel repeats the board and has few parts of its own, or none.
            designs = [job.design(name) for name in placed]
            best = max(designs, key=lambda d: len(d.parts))
            if others := [d.name for d in designs if d is not best]:
                text = "further steps have components: {names}; {step} was read. Choose by --step."
                best = best.with_notes(noted("several-steps", text, names=", ".join(others), step=best.name))
            best = best.with_notes(*note_on_panels([name for name in panels if name != best.name]))
        return replace(best, step=best.name, steps=known)


class _Job:
    """The files of a design, which lie in a folder of an archive."""

    def __init__(self, archive: Archive) -> None:
        self._archive, self._path = archive, archive.where
        root = next((found[1] for name in archive.members if (found := _MATRIX.match(name))), None)
        if root is None:
            raise InputError(f"{self._path}: has no file matrix/matrix; it is no ODB++ design.")
        self._root = root
        of_step = re.compile(re.escape(root) + r"steps/([^/]+)/")
        self.steps = sorted({found[1] for name in archive.members if (found := of_step.match(name))})
        info = self._lines("misc/info") or []
        units = (line.partition("=")[2].strip().upper() for line in info if line.startswith("UNITS"))
        self._default_mm = next((UNITS.get(unit) for unit in units), None)
        """The unit of files that state none; None if the design does not state it."""
        self._by_kicad = any(re.match(r"\s*SAVE_APP\s*=\s*KiCad\b", line) for line in info)

    def has(self, name: str) -> str | None:
        """Return the name of a member, which may be compressed (`.Z`, gzip); None if there is none."""
        full = f"{self._root}{name}".lower()
        return next((n for n in (full, f"{full}.z", f"{full}.gz") if n in self._archive.members), None)

    def _lines(self, name: str) -> list[str] | None:
        if (member := self.has(name)) is None:
            return None
        data, where = self._archive.members[member](), f"{self._path}: {self._root}{name}"
        if data[:2] == b"\x1f\x8b":
            try:
                with gzip.GzipFile(fileobj=io.BytesIO(data)) as packed:
                    data = packed.read(MOST_BYTES + 1)
            except (zlib.error, OSError, EOFError) as error:
                raise InputError(f"{where}: is no valid gzip file: {error}.") from error
            if len(data) > MOST_BYTES:
                raise InputError.field(
                    where, "its size", f"more than {MOST_BYTES} bytes", f"at most {MOST_BYTES} bytes"
                )
        elif data[:2] == unix_compress.MAGIC:
            data = unix_compress.decompress(data, where, MOST_BYTES)
        return decode(data, where).splitlines()

    def _file(self, name: str) -> OdbFile | None:
        lines = self._lines(name)
        return None if lines is None else OdbFile(f"{self._path}: {self._root}{name}", lines, self._default_mm)

    def repeats_steps(self, step: str) -> bool:
        """Return whether a step's header has repeats; one that cannot be read is refused when its step is chosen."""
        try:
            return has_repeats(self._lines(f"steps/{step}/stephdr") or ())
        except InputError:
            return True

    def step(self, name: str) -> Step:
        """Return a step with what it repeats; its datum is read only when a panel places it."""
        if name not in self.steps:
            raise InputError(f"{self._path}: a panel repeats step {name!r}, which the design does not have.")
        header = f"steps/{name}/stephdr"

        @cache
        def datum() -> XY:
            file = self._file(header)
            return datum_of(file) if file else (0.0, 0.0)

        design = self.design(name)
        file = self._file(header) if has_repeats(self._lines(header) or ()) else None
        return Step(design, datum, repeats_of(file) if file else ())

    def design(self, name: str) -> Design:
        """Return a step without what it repeats. Its header is not read: a wrong value there changes no board."""
        folder = f"steps/{name}"
        eda = self._file(f"{folder}/eda/data")
        packages = packages_of(eda)
        drawn: list[DrawnPart] = []
        pins: dict[tuple[Side, int, int], tuple[str, Toeprint]] = {}
        unreadable: list[str] = []
        for side, layer in _LAYERS:
            if (file := self._file(f"{folder}/layers/{layer}/components")) is not None:
                more, faults = self._components(file, side, packages, pins)
                drawn += more
                unreadable += faults
        parts, notes = placed_parts(drawn, self._usual_rule)
        if unreadable:
            text = "{count} toeprints state no pin with a place; they were left out: {names}."
            notes.append(noted("toeprints-left-out", text, count=len(unreadable), names=", ".join(unreadable[:8])))
        marks: list[Mark] = []
        matrix = self._lines("matrix/matrix") or []
        layers: dict[Side, tuple[str, dict[int, Pad]]] = {}
        openings: dict[Side, Openings] = {}
        for side, layer in outer_layers(matrix).items():
            if (copper := self._file(f"{folder}/layers/{layer}/features")) is not None:
                marks += pad_marks(copper.lines, copper.mm, side)
                layers[side] = layer, placed_pads(copper)
        for side, layer in mask_layers(matrix).items():
            mask = self._file(f"{folder}/layers/{layer}/features")
            if mask is not None and (pads := placed_pads(mask)):
                openings[side] = Openings(pad.at for pad in pads.values())
        # Pins of another datum than the parts would lie beside the board.
        moved = any(note.code == "pins-of-other-datum" for note in notes)
        points, more_notes = unmasked(() if moved else _net_points(copper_of(eda), pins, layers), openings)
        notes += more_notes
        profile = self._file(f"{folder}/profile")
        outline, cut_outs = _board(list(_contours(profile)) if profile else [], [part.origin for part in parts], notes)
        return Design(
            name,
            "odb",
            tuple(parts),
            outline,
            cut_outs,
            marks=tuple(marks),
            net_points=numbered(points),
            notes=tuple(notes),
        )

    def _usual_rule(self, side: Side, _word: str) -> Rule:
        """Return the rule of the specification, or of KiCad."""
        return Rule(mirrored=False, sign=-1) if side == "top" or self._by_kicad else Rule(mirrored=True, sign=1)

    def _components(
        self,
        file: OdbFile,
        side: Side,
        packages: list[Package],
        known: dict[tuple[Side, int, int], tuple[str, Toeprint]],
    ) -> tuple[list[DrawnPart], list[str]]:
        """Return the parts of a side and the toeprints that cannot be read; add the others to `known`."""
        names: dict[str, str] = {}
        found: list[tuple[DrawnPart, Package, list[Toeprint]]] = []
        unreadable: list[str] = []
        for number, line in enumerate(file.lines, 1):
            if match := re.match(r"@(\d+)\s+(\S+)", line):
                names[match[1]] = match[2].lower()
            elif line.startswith("TOP ") and found:
                if (toeprint := toeprint_of(line, file.mm)) is not None:
                    found[-1][2].append(toeprint)
                    known[side, len(found) - 1, toeprint.number] = found[-1][0].part.ref, toeprint
                else:
                    unreadable.append(f"{found[-1][0].part.ref} (line {number})")
            elif line.startswith("CMP "):
                drawn, package = self._component(file, number, side, packages, names)
                found.append((drawn, package, []))
        parts = [replace(d, readings=readings(package, pins)) if pins else d for d, package, pins in found]
        return parts, unreadable

    def _component(
        self, file: OdbFile, number: int, side: Side, packages: list[Package], names: dict[str, str]
    ) -> tuple[DrawnPart, Package]:
        line = file.lines[number - 1]
        words = line.partition(";")[0].split()
        if len(words) < 7:
            raise InputError(
                f"{file.where}, line {number}: {line[:80]!r} must be CMP package x y rotation mirror name part."
            )
        index, x, y, degrees = file.numbers(number, words[1:], 4)
        package = packages[int(index)] if 0 <= index < len(packages) else Package("")
        attributes = attributes_of(line, names)
        height = number_of(attributes.get(".comp_height"))
        part = Part(
            ref=words[6],
            side=side,
            origin=(x * file.mm, y * file.mm),
            rotation=degrees,
            package=package.name,
            value=words[7] if len(words) > 7 else "",
            box=package.box(self._by_kicad),
            body_height=height * file.mm if height else None,
            fitted=".no_pop" not in attributes and ".comp_ignore" not in attributes,
            is_mark=any(a in attributes for a in _MARK_ATTRIBUTES) or "fiducial" in package.name.lower(),
            mark_diameter=package.pad,
            line=number,
        )
        return DrawnPart(part, word=words[5], pads=box_around(package.pads)), package


def _net_points(
    copper: Sequence[Copper],
    pins: dict[tuple[Side, int, int], tuple[str, Toeprint]],
    layers: dict[Side, tuple[str, dict[int, Pad]]],
) -> Iterator[NetPoint]:
    """Yield the pads and vias of the nets on the outer layers."""
    for net, key, features in copper:
        on = {side: pads.get(features[name]) for side, (name, pads) in layers.items() if name in features}
        pad = next((pad for pad in on.values() if pad is not None), None)
        if not on or (pad is None if key is None else key not in pins):
            continue
        ref, pin, at = "", "", (0.0, 0.0) if pad is None else pad.at
        if key is not None:
            ref, toeprint = pins[key]
            # The copper decides: KiCad mirrors the toeprints of pads that are drawn as surfaces.
            pin, at = toeprint.name or str(toeprint.number + 1), toeprint.at if pad is None else pad.at
        kind: PointKind = "via" if key is None else "pin" if len(on) > 1 else "pad"
        yield NetPoint(ref, pin, net, at, "top" in on, "bottom" in on, kind, pad and pad.diameter)


class _Contour(NamedTuple):
    corners: Contour
    is_hole: bool


def _board(
    contours: Sequence[_Contour], origins: Sequence[XY], notes: list[Note]
) -> tuple[Contour, tuple[Contour, ...]]:
    """Return the island that most parts lie on, of equals the largest, and the other contours.

    Islands within it lie in its holes, such as a board in a frame that has most parts; they are no cut-outs.
    """
    by_size = sorted(contours, key=lambda contour: abs(area(contour.corners)))
    islands = [contour for contour in by_size if not contour.is_hole] or by_size
    chosen, inside = islands[0].corners if islands else (), list[_Contour]()
    if len(islands) > 1:
        # shapely is loaded when there are islands: the command line must start fast.
        from shapely import Polygon, STRtree, points

        polygons = [Polygon(contour.corners) for contour in by_size]
        innermost: dict[int, int] = {}
        for point, contour in zip(*STRtree(polygons).query(points(origins), predicate="within").tolist(), strict=True):
            innermost[point] = min(contour, innermost.get(point, contour))
        counts = Counter(by_size[contour].corners for contour in innermost.values())
        # Of equals the last of the sorted ones is the largest.
        chosen = max(reversed(islands), key=lambda island: counts[island.corners]).corners
        inside = [c for c in islands if c.corners is not chosen and encloses(chosen, c.corners[0])]
    if inside:
        at = places(min(island.corners) for island in inside)
        text = "{count} contours lie within a cut-out; they were left out: from {at} on."
        notes.append(noted("islands-left-out", text, count=len(inside), at=at))
    return chosen, tuple(c.corners for c in contours if c.corners is not chosen and c not in inside)


def _contours(file: OdbFile) -> Iterator[_Contour]:
    corners: list[XY] = []
    is_hole = False
    for number, line in enumerate(file.lines, 1):
        words = line.split() or [""]
        if words[0] == "OB":
            corners = outline_points(file, number, words)
            is_hole = len(words) > 3 and words[3].upper() == "H"
        elif words[0] == "OS" and corners:
            corners += outline_points(file, number, words)
        elif words[0] == "OC" and corners:
            x, y, cx, cy = (v * file.mm for v in file.numbers(number, words[1:], 4))
            clockwise = len(words) > 5 and words[5].upper() == "Y"
            corners += arc_points(corners[-1], (x, y), (cx, cy), clockwise)[1:]
        elif words[0] == "OE" and corners:
            closed = corners[:-1] if corners[0] == corners[-1] else corners
            if len(closed) > 2:
                yield _Contour(tuple(closed), is_hole)
            corners = []
