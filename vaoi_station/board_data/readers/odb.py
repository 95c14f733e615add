"""Read ODB++ designs, versions 7 and 8, as a folder, a zip file or a tar file.

A package is drawn as seen from the side of the part. A part on the bottom is mirrored in x first. Then the part turns
clockwise as seen from the top, on either side. Every file states a unit. Source: ODB++ specification 8.1; KiCad's
export and its board file agree in this. KiCad writes courtyards as outlines of packages.
"""

from __future__ import annotations

import gzip
import io
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from vaoi_station.board_data.contours import arc_points, circle_points
from vaoi_station.board_data.design import (
    KICAD_COURTYARD_MM,
    XY,
    Box,
    Design,
    Mark,
    Part,
    Side,
    box_around,
    normalised,
)
from vaoi_station.board_data.panels import Step, note_on_panels, panel_of
from vaoi_station.board_data.readers import unix_compress
from vaoi_station.board_data.readers.odb_features import outer_layers, pad_marks
from vaoi_station.board_data.readers.odb_repeats import datum_of, has_repeats, repeats_of
from vaoi_station.board_data.source_text import (
    MOST_BYTES,
    Archive,
    decode,
    names_before_damage,
    number_of,
    open_archive,
)
from vaoi_station.errors import InputError
from vaoi_station.model.note import Note

_UNITS = {"MM": 1.0, "INCH": 25.4}
_LEAST_COURTYARD_MM = 0.05
"""A courtyard is at least this far from every pin; KiCad's libraries have 0.15 and more."""
_MARK_ATTRIBUTES = (".fiducial_name", ".fiducial_rotation")
_LAYERS: tuple[tuple[Side, str], ...] = (("top", "comp_+_top"), ("bottom", "comp_+_bot"))


def is_odb(path: Path) -> bool:
    """Return whether a folder or an archive has the structure of an ODB++ design."""
    try:
        with open_archive(path) as archive:
            return any(re.search(r"(^|/)matrix/matrix(\.g?z)?$", name) for name in archive.names())
    except InputError:
        # Of a damaged archive the names before the damage show what it was; `read_odb` then refuses it as damaged.
        return any(re.search(r"(^|/)(matrix|steps|symbols|misc|fonts)/", name) for name in names_before_damage(path))


def read_odb(path: Path, step: str | None = None) -> Design:
    """Read one step of an ODB++ design; by default the only one, or the one with most components.

    A panel has its boards, which are not laid out yet.
    """
    with open_archive(path) as archive:
        root = _root(archive, path)
        steps = sorted({m[1] for n in archive.names() if (m := re.match(re.escape(root) + r"steps/([^/]+)/", n))})
        placed = [
            s
            for s in steps
            if any(_found(archive, f"{root}steps/{s}/layers/{layer}/components") for _, layer in _LAYERS)
        ]
        panels = [s for s in steps if _repeats_steps(archive, f"{root}steps/{s}/stephdr")]
        known = tuple(s for s in steps if s in placed or s in panels)
        if step is not None and step.lower() not in known:
            raise InputError.field(
                path, "--step", step, f"a step with components or repeats: {', '.join(known) or 'there is none'}"
            )
        if not placed:
            raise InputError(
                f"{path}: no step has components (steps: {', '.join(steps) or 'none'}). "
                "Export the design with component layers comp_+_top and comp_+_bot."
            )
        notes = []
        if step is None:
            # A panel repeats the board and has few parts of its own, or none.
            designs = [_design(archive, root, path, name) for name in placed]
            best = max(designs, key=lambda d: len(d.parts))
            if others := [d.name for d in designs if d is not best]:
                names = ", ".join(others)
                sentence = f"further steps have components: {names}; {best.name} was read. Choose by --step."
                notes.append(Note("several-steps", sentence, names=names, step=best.name))
            notes += note_on_panels([name for name in panels if name != best.name])
        else:
            best = panel_of(step.lower(), lambda name: _named_step(archive, root, path, name), str(path))
        return replace(best.with_notes(*notes), step=best.name, steps=known)


def _named_step(archive: Archive, root: str, path: Path, name: str) -> Step:
    if not any(member.startswith(f"{root}steps/{name}/") for member in archive.names()):
        raise InputError(f"{path}: a panel repeats step {name!r}, which the design does not have.")
    design, header = _design(archive, root, path, name), f"{root}steps/{name}/stephdr"

    def header_file() -> _File:
        return _File(f"{path}: {header}", _lines(archive, header) or [], _default_mm(archive, root))

    @cache
    def datum() -> XY:
        file = header_file()
        return datum_of(file.where, file.lines, file.mm)

    if not has_repeats(_lines(archive, header) or ()):
        return Step(design, datum)
    file = header_file()
    return Step(design, datum, repeats_of(file.where, file.lines, file.mm))


def _repeats_steps(archive: Archive, name: str) -> bool:
    """Return whether a step's header has repeats; one that cannot be read is refused when its step is chosen."""
    try:
        return has_repeats(_lines(archive, name) or ())
    except InputError:
        return True


def _root(archive: Archive, path: Path) -> str:
    """Return the folder of the design within the archive."""
    for name in archive.names():
        if found := re.match(r"(.*?)matrix/matrix(\.g?z)?$", name):
            return found[1]
    raise InputError(f"{path}: has no file matrix/matrix; it is no ODB++ design.")


def _found(archive: Archive, name: str) -> str | None:
    """Return the name of a member, which may be compressed (`.Z`, gzip)."""
    return next((n for n in (name, f"{name}.z", f"{name}.gz") if n in archive), None)


def _lines(archive: Archive, name: str) -> list[str] | None:
    """Return the lines of a member, decompressed; None if there is none."""
    member = _found(archive, name)
    if member is None:
        return None
    data, where = archive.read(member), f"{archive.where}: {name}"
    if data[:2] == b"\x1f\x8b":
        try:
            with gzip.GzipFile(fileobj=io.BytesIO(data)) as packed:
                inflated = packed.read(MOST_BYTES + 1)
        except (zlib.error, OSError, EOFError) as error:
            raise InputError(f"{where}: is no valid gzip file: {error}.") from error
        if len(inflated) > MOST_BYTES:
            raise InputError.field(where, "its size", f"more than {MOST_BYTES} bytes", f"at most {MOST_BYTES} bytes")
        data = inflated
    elif data[:2] == unix_compress.MAGIC:
        data = unix_compress.decompress(data, where, MOST_BYTES)
    return decode(data, where).splitlines()


@dataclass
class _Package:
    name: str
    points: list[XY]
    pins: list[XY]
    pad: float | None = None
    """Largest extent of its first pin."""

    def box(self, by_kicad: bool) -> Box | None:
        """Return the box of the body; None if the package has none."""
        outline, pins = box_around(self.points), box_around(self.pins)
        # KiCad writes the courtyard. Where a footprint has none it writes a hull of everything, which touches the pins.
        if by_kicad and outline is not None and pins is not None and outline.contains(pins, _LEAST_COURTYARD_MM):
            return outline.shrunk(KICAD_COURTYARD_MM)
        return outline


class _File:
    """The lines of one file, in its own unit."""

    def __init__(self, where: str, lines: list[str], default: float | None) -> None:
        self.where, self.lines = where, lines
        unit = next(
            (m[1].upper() for line in lines[:50] if (m := re.match(r"\s*(?:UNITS\s*=|U\s+)\s*(\w+)", line))), None
        )
        if unit is not None and unit not in _UNITS:
            raise InputError.field(where, "UNITS", unit, "MM or INCH")
        # Until version 7 a file without UNITS is in inches.
        self.mm = _UNITS[unit] if unit else (default if default is not None else 25.4)

    def numbers(self, number: int, words: list[str], count: int) -> list[float]:
        """Return the first `count` words as numbers, unscaled."""
        found = [v for w in words[:count] if (v := number_of(w)) is not None]
        if len(found) != count:
            raise InputError(f"{self.where}, line {number}: {self.lines[number - 1][:80]!r} must have {count} numbers.")
        return found


def _default_mm(archive: Archive, root: str) -> float | None:
    """Return the unit, mm, of files that state none; None if the design does not state it."""
    info = _lines(archive, f"{root}misc/info") or []
    return next((_UNITS.get(line.partition("=")[2].strip().upper()) for line in info if line.startswith("UNITS")), None)


def _design(archive: Archive, root: str, path: Path, name: str) -> Design:
    """Return a step without what it repeats. Its header is not read: a wrong value there changes no board."""
    folder, default = f"{root}steps/{name}", _default_mm(archive, root)
    packages = _packages(_file(archive, path, f"{folder}/eda/data", default))
    by_kicad = _by_kicad(archive, root)
    parts: list[Part] = []
    for side, layer in _LAYERS:
        file = _file(archive, path, f"{folder}/layers/{layer}/components", default)
        if file is not None:
            parts += _components(file, side, packages, by_kicad)
    marks: list[Mark] = []
    for side, layer in outer_layers(_lines(archive, f"{root}matrix/matrix") or []).items():
        copper = _file(archive, path, f"{folder}/layers/{layer}/features", default)
        marks += pad_marks(copper.lines, copper.mm, side) if copper is not None else ()
    profile = _file(archive, path, f"{folder}/profile", default)
    contours = list(_contours(profile)) if profile else []
    outline = contours[0] if contours else []
    return Design(name, "odb", tuple(parts), tuple(outline), tuple(map(tuple, contours[1:])), marks=tuple(marks))


def _file(archive: Archive, path: Path, name: str, default: float | None) -> _File | None:
    lines = _lines(archive, name)
    return None if lines is None else _File(f"{path}: {name}", lines, default)


def _by_kicad(archive: Archive, root: str) -> bool:
    return any(re.match(r"\s*SAVE_APP\s*=\s*KiCad\b", line) for line in _lines(archive, f"{root}misc/info") or ())


def _packages(file: _File | None) -> list[_Package]:
    """Return the packages in the order of their numbers, with the outline of their bodies and pins, mm."""
    found: list[_Package] = []
    in_pin = False
    for number, line in enumerate(file.lines if file else [], 1):
        words = line.split(";")[0].split()
        if not words or file is None:
            continue
        if words[0] == "PKG" and len(words) >= 7:
            box = [v * file.mm for v in file.numbers(number, words[3:], 4)]
            found.append(_Package(words[1], [], []))
            found[-1].points = [(box[0], box[1]), (box[2], box[3])]
            in_pin, outlined = False, False
        elif not found:
            continue
        elif words[0] == "PIN":
            in_pin = True
        elif words[0] in ("RC", "CR", "SQ", "OB", "OS", "OC"):
            points = _outline_points(file, number, words)
            if in_pin:
                found[-1].pins += points
                box_of_pad = box_around(points)
                if box_of_pad and found[-1].pad is None:
                    found[-1].pad = max(box_of_pad.size)
            elif not outlined or words[0] in ("OS", "OC"):
                # The first outline replaces the bounding box of the line PKG, which includes the pins.
                found[-1].points = [*(found[-1].points if outlined else []), *points]
                outlined = True
    return found


def _outline_points(file: _File, number: int, words: list[str]) -> list[XY]:
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


def _components(file: _File, side: Side, packages: list[_Package], by_kicad: bool) -> Iterator[Part]:
    """Yield the parts of a component layer."""
    names: dict[str, str] = {}
    for number, line in enumerate(file.lines, 1):
        if match := re.match(r"@(\d+)\s+(\S+)", line):
            names[match[1]] = match[2].lower()
        if not line.startswith("CMP "):
            continue
        head, _, tail = line.partition(";")
        words = head.split()
        if len(words) < 7:
            raise InputError(
                f"{file.where}, line {number}: {line[:80]!r} must be CMP package x y rotation mirror name part."
            )
        index, x, y, clockwise = file.numbers(number, words[1:], 4)
        package = packages[int(index)] if 0 <= index < len(packages) else _Package("", [], [])
        attributes = dict(_attributes(tail, names))
        box = package.box(by_kicad)
        if box is not None and side == "bottom":
            box = box.mirrored()
        height = number_of(attributes.get(".comp_height"))
        is_mark = any(a in attributes for a in _MARK_ATTRIBUTES) or "fiducial" in package.name.lower()
        yield Part(
            ref=words[6],
            side=side,
            origin=(x * file.mm, y * file.mm),
            rotation=normalised(-clockwise),
            package=package.name,
            value=words[7] if len(words) > 7 else "",
            box=box,
            body_height=height * file.mm if height else None,
            fitted=".no_pop" not in attributes and ".comp_ignore" not in attributes,
            is_mark=is_mark,
            mark_diameter=package.pad,
            line=number,
        )


def _attributes(tail: str, names: dict[str, str]) -> Iterator[tuple[str, str]]:
    """Yield name and value of the attributes of a line: `;0=0.0374,1=0;ID=2083`."""
    for item in tail.split(";", maxsplit=1)[0].split(","):
        key, _, value = item.strip().partition("=")
        if key in names:
            yield names[key], value


def _contours(file: _File) -> Iterator[list[XY]]:
    """Yield the contours of a profile: the island first, then its holes."""
    points: list[XY] = []
    for number, line in enumerate(file.lines, 1):
        words = line.split()
        if not words:
            continue
        if words[0] == "OB":
            points = _outline_points(file, number, words)
        elif words[0] == "OS" and points:
            points += _outline_points(file, number, words)
        elif words[0] == "OC" and points:
            x, y, cx, cy = (v * file.mm for v in file.numbers(number, words[1:], 4))
            clockwise = len(words) > 5 and words[5].upper() == "Y"
            points += arc_points(points[-1], (x, y), (cx, cy), clockwise)[1:]
        elif words[0] == "OE" and points:
            closed = points[:-1] if points[0] == points[-1] else points
            if len(closed) > 2:
                yield closed
            points = []
