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

from vaoi_station.board_data.contours import arc_points, area, places
from vaoi_station.board_data.design import XY, Design, Mark, Part, Side, box_around
from vaoi_station.board_data.panels import Step, note_on_panels, panel_of
from vaoi_station.board_data.pin_rules import DrawnPart, Rule, Usual, placed_parts
from vaoi_station.board_data.readers import unix_compress
from vaoi_station.board_data.readers.odb_features import outer_layers, pad_marks
from vaoi_station.board_data.readers.odb_packages import (
    UNITS,
    OdbFile,
    Package,
    Toeprint,
    outline_points,
    packages_of,
    readings,
    toeprint_of,
)
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
from vaoi_station.geometry.polygon import encloses
from vaoi_station.model.reason import Note

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

    def header_file() -> OdbFile:
        return OdbFile(f"{path}: {header}", _lines(archive, header) or [], _default_mm(archive, root))

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


def _default_mm(archive: Archive, root: str) -> float | None:
    """Return the unit, mm, of files that state none; None if the design does not state it."""
    info = _lines(archive, f"{root}misc/info") or []
    return next((UNITS.get(line.partition("=")[2].strip().upper()) for line in info if line.startswith("UNITS")), None)


def _design(archive: Archive, root: str, path: Path, name: str) -> Design:
    """Return a step without what it repeats. Its header is not read: a wrong value there changes no board."""
    folder, default = f"{root}steps/{name}", _default_mm(archive, root)
    packages = packages_of(_file(archive, path, f"{folder}/eda/data", default))
    by_kicad = _by_kicad(archive, root)
    drawn: list[DrawnPart] = []
    unreadable: list[str] = []
    for side, layer in _LAYERS:
        file = _file(archive, path, f"{folder}/layers/{layer}/components", default)
        if file is not None:
            more, faults = _components(file, side, packages, by_kicad)
            drawn += more
            unreadable += faults
    parts, notes = placed_parts(drawn, _usual_rule(by_kicad))
    if unreadable:
        names = ", ".join(unreadable[:8])
        sentence = f"{len(unreadable)} toeprints state no pin with a place; they were left out: {names}."
        notes.append(Note("toeprints-left-out", sentence, count=len(unreadable), names=names))
    marks: list[Mark] = []
    for side, layer in outer_layers(_lines(archive, f"{root}matrix/matrix") or []).items():
        copper = _file(archive, path, f"{folder}/layers/{layer}/features", default)
        marks += pad_marks(copper.lines, copper.mm, side) if copper is not None else ()
    profile = _file(archive, path, f"{folder}/profile", default)
    outline, cut_outs = _board(list(_contours(profile)) if profile else [], [part.origin for part in parts], notes)
    return Design(
        name,
        "odb",
        tuple(parts),
        outline,
        cut_outs,
        marks=tuple(marks),
        notes=tuple(notes),
    )


def _file(archive: Archive, path: Path, name: str, default: float | None) -> OdbFile | None:
    lines = _lines(archive, name)
    return None if lines is None else OdbFile(f"{path}: {name}", lines, default)


def _by_kicad(archive: Archive, root: str) -> bool:
    return any(re.match(r"\s*SAVE_APP\s*=\s*KiCad\b", line) for line in _lines(archive, f"{root}misc/info") or ())


def _components(
    file: OdbFile, side: Side, packages: list[Package], by_kicad: bool
) -> tuple[list[DrawnPart], list[str]]:
    """Return the parts of a component layer, and its toeprints that state no pin and place."""
    names: dict[str, str] = {}
    found: list[DrawnPart] = []
    toeprints: list[Toeprint] = []
    unreadable: list[str] = []

    def add_toeprints() -> None:
        if found and toeprints:
            found[-1] = replace(found[-1], readings=readings(package, toeprints))
            toeprints.clear()

    package = Package("")
    for number, line in enumerate(file.lines, 1):
        if match := re.match(r"@(\d+)\s+(\S+)", line):
            names[match[1]] = match[2].lower()
        if line.startswith("TOP ") and found:
            if (toeprint := toeprint_of(line, file.mm)) is not None:
                toeprints.append(toeprint)
            else:
                unreadable.append(f"{found[-1].part.ref} (line {number})")
        if not line.startswith("CMP "):
            continue
        add_toeprints()
        head, _, tail = line.partition(";")
        words = head.split()
        if len(words) < 7:
            raise InputError(
                f"{file.where}, line {number}: {line[:80]!r} must be CMP package x y rotation mirror name part."
            )
        index, x, y, degrees = file.numbers(number, words[1:], 4)
        package = packages[int(index)] if 0 <= index < len(packages) else Package("")
        attributes = dict(_attributes(tail, names))
        height = number_of(attributes.get(".comp_height"))
        is_mark = any(a in attributes for a in _MARK_ATTRIBUTES) or "fiducial" in package.name.lower()
        part = Part(
            ref=words[6],
            side=side,
            origin=(x * file.mm, y * file.mm),
            rotation=degrees,
            package=package.name,
            value=words[7] if len(words) > 7 else "",
            box=package.box(by_kicad),
            body_height=height * file.mm if height else None,
            fitted=".no_pop" not in attributes and ".comp_ignore" not in attributes,
            is_mark=is_mark,
            mark_diameter=package.pad,
            line=number,
        )
        found.append(DrawnPart(part, word=words[5], pads=box_around(package.pads)))
    add_toeprints()
    return found, unreadable


def _usual_rule(by_kicad: bool) -> Usual:
    """Return the rules of the specification, or those of KiCad."""

    def usual(side: Side, _word: str) -> Rule:
        return Rule(mirrored=False, sign=-1) if side == "top" or by_kicad else Rule(mirrored=True, sign=1)

    return usual


def _attributes(tail: str, names: dict[str, str]) -> Iterator[tuple[str, str]]:
    """Yield name and value of the attributes of a line: `;0=0.0374,1=0;ID=2083`."""
    for item in tail.split(";", maxsplit=1)[0].split(","):
        key, _, value = item.strip().partition("=")
        if key in names:
            yield names[key], value


class _Contour(NamedTuple):
    corners: tuple[XY, ...]
    is_hole: bool


def _board(
    contours: Sequence[_Contour], origins: Sequence[XY], notes: list[Note]
) -> tuple[tuple[XY, ...], tuple[tuple[XY, ...], ...]]:
    """Return the island that most parts lie on, of equals the largest, and the other contours.

    Islands within it lie in its holes, such as a board in a frame that has most parts; they are no cut-outs.
    """
    by_size = sorted(contours, key=lambda contour: abs(area(contour.corners)))
    islands = [contour for contour in by_size if not contour.is_hole] or by_size
    if len(islands) < 2:
        chosen = islands[0].corners if islands else ()
        return chosen, tuple(c.corners for c in contours if c.corners is not chosen)
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
        sentence = f"{len(inside)} contours lie within a cut-out; they were left out: from {at} on."
        notes.append(Note("islands-left-out", sentence, count=len(inside), at=at))
    return chosen, tuple(c.corners for c in contours if c.corners is not chosen and c not in inside)


def _contours(file: OdbFile) -> Iterator[_Contour]:
    """Yield the contours of a profile, islands and holes in any order."""
    corners: list[XY] = []
    is_hole = False
    for number, line in enumerate(file.lines, 1):
        words = line.split()
        if not words:
            continue
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
