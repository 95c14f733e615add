"""Read KiCad boards (`.kicad_pcb`, versions 5 to 10).

KiCad's y points down, its rotations are counter-clockwise as seen on the screen from the top. A footprint on the bottom
is stored as it is seen from the top. Description of the format: dev-docs.kicad.org, "PCB file format".
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from vaoi_station.board_data.contours import arc_points, arc_through, circle_points, find_contours
from vaoi_station.board_data.design import (
    KICAD_COURTYARD_MM,
    LEAST_DRAWING,
    XY,
    Box,
    Design,
    Mark,
    MarkKind,
    Part,
    Side,
    body_of,
    box_around,
    normalised,
    rotated,
)
from vaoi_station.board_data.marks import kind_by_name
from vaoi_station.board_data.readers.sexpr import Node, every, first, numbers, parse_sexpr, text_of
from vaoi_station.board_data.readers.table_columns import is_fitted
from vaoi_station.board_data.source_text import decode
from vaoi_station.errors import InputError
from vaoi_station.model.reason import Note

_MARK_PROPERTIES: dict[str, MarkKind] = {"pad_prop_fiducial_glob": "global", "pad_prop_fiducial_loc": "local"}
_UNFITTED = frozenset({"DNP", "DNI", "DNF"})
"""Names of properties by which users state that a part is not fitted."""
_LEAST_BODY = 0.2
"""A body is at least this share of its pads, along both axes, and along one of them `LEAST_DRAWING`."""


def is_kicad(head: bytes) -> bool:
    """Return whether a file begins like a KiCad board."""
    return head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"(kicad_pcb")


def read_kicad(data: bytes, path: Path) -> Design:
    """Read a KiCad board file."""
    root = parse_sexpr(decode(data, path), path)
    if not root or root[0] != "kicad_pcb":
        raise InputError(f"{path}: begins with ({root[0] if root else ''} …, a KiCad board begins with (kicad_pcb …).")
    try:
        return _design(root, path)
    except InputError as error:  # of a number; the functions that read one do not know the file
        raise InputError(f"{path}: {error.message}") from error


def _design(root: Node, path: Path) -> Design:
    parts, unplaced = [], 0
    marks: list[Mark] = []
    for footprint in every(root, "footprint", "module"):
        part = _part(footprint)
        marks += _marks(footprint, part)
        if part is None:
            unplaced += 1
        else:
            parts.append(part)
    contours = find_contours(_edges(root), "Edge.Cuts")
    notes = []
    if variants := [text_of(v, "name") for v in every(first(root, "variants") or [], "variant")]:
        # Version 10. Footprints state what differs in a variant; the file does not state which one is current.
        names = ", ".join(variants)
        sentence = f"the file has assembly variants ({names}); the default one was read."
        notes.append(Note("variant-read", sentence, names=names, variant=""))
    if unplaced:
        sentence = f"{unplaced} footprints are not for placement, or have no designator; they were left out."
        notes.append(Note("footprints-left-out", sentence, count=unplaced))
    return Design(
        name=text_of(first(root, "title_block") or [], "title") or path.stem,
        format="kicad",
        parts=tuple(parts),
        outline=contours.outline,
        cut_outs=contours.others,
        islands=contours.islands,
        marks=tuple(marks),
        notes=(*notes, *contours.notes),
    )


def _part(footprint: Node) -> Part | None:
    """Return the part of a footprint; None if it is none that is placed."""
    attributes = {str(a) for node in every(footprint, "attr") for a in node[1:]}
    ref = _text(footprint, "reference")
    at = numbers(first(footprint, "at"))
    if not ref or ref.startswith("#") or len(at) < 2 or attributes & {"virtual", "exclude_from_pos_files"}:
        return None
    rotation = at[2] if len(at) > 2 else 0.0
    properties = {str(n[1]): str(n[2]) for n in every(footprint, "property") if len(n) > 2}
    value = _text(footprint, "value")
    stated = [(name, cell) for name, cell in properties.items() if name.upper() in _UNFITTED]
    name = str(footprint[1]) if len(footprint) > 1 and not isinstance(footprint[1], list) else ""
    side: Side = "bottom" if text_of(footprint, "layer").startswith("B.") else "top"
    return Part(
        ref=ref,
        side=side,
        origin=(at[0], -at[1]),
        rotation=normalised(rotation),
        package=name.rpartition(":")[2],
        value=value,
        box=_body(footprint, rotation, side),
        # Version 7 has the property "dnp" without a value, older ones only what users write into value or fields.
        fitted="dnp" not in attributes
        and properties.get("dnp", "no") != ""
        and is_fitted("", "", (value,))
        and all(is_fitted(cell, name, "") for name, cell in stated),
        in_bom=not ("exclude_from_bom" in attributes or "exclude_from_bom" in properties),
        is_mark=_is_mark(footprint),
        mark_kind=next(_marked_pads(footprint), (None, None))[1] if len(list(every(footprint, "pad"))) == 1 else None,
        mark_diameter=_pad_diameter(footprint),
    )


def _is_mark(footprint: Node) -> bool:
    return "fiducial" in f"{footprint[1:2]} {text_of(footprint, 'tags')}".lower()


def _marked_pads(footprint: Node) -> Iterator[tuple[Node, MarkKind]]:
    """Yield the pads whose property says that they are fiducials."""
    for pad in every(footprint, "pad"):
        kind = _MARK_PROPERTIES.get(text_of(pad, "property"))
        if kind is not None:
            yield pad, kind


def _marks(footprint: Node, part: Part | None) -> Iterator[Mark]:
    """Yield the fiducials of a footprint that are no placed part of their own."""
    at, ref = numbers(first(footprint, "at")), _text(footprint, "reference")
    if len(at) < 2:
        return
    side: Side = "bottom" if text_of(footprint, "layer").startswith("B.") else "top"
    pads = list(every(footprint, "pad"))
    if len(pads) > 1:
        turn = at[2] if len(at) > 2 else 0.0
        for n, (pad, kind) in enumerate(_marked_pads(footprint)):
            where, size = numbers(first(pad, "at")), numbers(first(pad, "size"))
            if len(where) >= 2 and size:
                dx, dy = rotated((where[0], -where[1]), turn)
                of = (part.ref,) if part is not None and kind == "local" else ()
                yield Mark(f"{ref}.FID{n + 1}", side, (at[0] + dx, dy - at[1]), max(size), kind, "attribute", of)
    elif part is None and pads and _is_mark(footprint):
        kind = next(_marked_pads(footprint), (None, kind_by_name(ref, str(footprint[1]))))[1]
        yield Mark(ref or "FID", side, (at[0], -at[1]), _pad_diameter(footprint), kind, "package")


def _text(footprint: Node, kind: str) -> str:
    """Return the reference or the value of a footprint: a property since version 8, a text before."""
    for node in every(footprint, "property"):
        if len(node) > 2 and str(node[1]).lower() == kind:
            return str(node[2])
    return next((str(n[2]) for n in every(footprint, "fp_text") if len(n) > 2 and n[1] == kind), "")


def _body(footprint: Node, rotation: float, side: Side) -> Box | None:
    """Return the body: the drawing of the fabrication layer, else the courtyard without its margin, else the pads.

    A drawing that is much smaller than the pads is a mark of pin 1. Without both layers, the silkscreen counts with the
    pads.
    """
    layer = "B" if side == "bottom" else "F"
    pads = box_around(p for pad in every(footprint, "pad") for p in _pad_corners(pad, rotation))
    drawn, courtyard, silkscreen = (
        box_around(p for piece in _drawing(footprint, "fp_", f"{layer}.{name}") for p in piece)
        for name in ("Fab", "CrtYd", "SilkS")
    )
    if drawn is not None and _is_body(drawn, pads):
        return drawn
    if courtyard is not None and _is_body(courtyard, pads):
        return courtyard.shrunk(KICAD_COURTYARD_MM)
    return body_of(silkscreen, pads)


def _is_body(drawing: Box, pads: Box | None) -> bool:
    """Return whether a drawing is large enough for a body; along one axis pads may reach far beyond one."""
    if pads is None:
        return True
    least, most = sorted(d / p for d, p in zip(drawing.size, pads.size, strict=True))
    return least >= _LEAST_BODY and most >= LEAST_DRAWING


def _pad_corners(pad: Node, rotation: float) -> list[XY]:
    """Return the corners of a pad in the frame of its footprint. Its own angle includes that of the footprint."""
    at, size = numbers(first(pad, "at")), numbers(first(pad, "size"))
    if len(at) < 2 or len(size) < 2:
        return []
    turn = (at[2] if len(at) > 2 else 0.0) - rotation
    corners = [rotated((sx * size[0] / 2, sy * size[1] / 2), turn) for sx in (-1, 1) for sy in (-1, 1)]
    return [(at[0] + x, -at[1] + y) for x, y in corners]


def _pad_diameter(footprint: Node) -> float | None:
    """Return the diameter of the copper of a fiducial."""
    sizes = [size for pad in every(footprint, "pad") if (size := numbers(first(pad, "size"))) and max(size) > 0]
    return max(sizes[0]) if sizes else None


def _drawing(node: Node, prefix: str, layer: str) -> Iterator[list[XY]]:
    """Yield lines and arcs of a drawing on a layer as points, y up. In a footprint they are relative to its origin."""
    kinds = ("line", "arc", "circle", "rect", "poly", "curve")
    for shape in every(node, *(prefix + kind for kind in kinds)):
        if text_of(shape, "layer") != layer:
            continue
        kind = str(shape[0]).removeprefix(prefix)
        point = {key: _xy(shape, key) for key in ("start", "end", "mid", "center")}
        if kind == "line" and point["start"] and point["end"]:
            yield [point["start"], point["end"]]
        elif kind == "rect" and point["start"] and point["end"]:
            yield _rectangle(point["start"], point["end"], (numbers(first(shape, "radius")) or [0.0])[0])
        elif kind == "circle" and point["center"] and point["end"]:
            yield circle_points(point["center"], math.dist(point["center"], point["end"]))
        elif kind == "arc" and point["start"] and point["end"]:
            yield _arc(shape, point["start"], point["mid"], point["end"])
        elif kind in ("poly", "curve"):
            corners = _points(first(shape, "pts") or [])
            if corners:
                yield [*corners, corners[0]] if kind == "poly" else _bezier(corners)


def _rectangle(start: XY, end: XY, radius: float) -> list[XY]:
    """Return a rectangle; since version 10 its corners may be rounded."""
    (x0, y0), (x1, y1) = (tuple(map(pick, start, end)) for pick in (min, max))
    radius = min(radius, (x1 - x0) / 2, (y1 - y0) / 2)
    if radius <= 0:
        return [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
    found = []
    for sx, sy, (x, y) in ((-1, -1, (x0, y0)), (1, -1, (x1, y0)), (1, 1, (x1, y1)), (-1, 1, (x0, y1))):
        beside_x, beside_y = (x - sx * radius, y), (x, y - sy * radius)
        ends = (beside_y, beside_x) if sx == sy else (beside_x, beside_y)  # counter-clockwise around the rectangle
        found += arc_points(*ends, (x - sx * radius, y - sy * radius), clockwise=False)
    return [*found, found[0]]


def _points(pts: Node) -> list[XY]:
    """Return the corners of a polygon; since version 6 arcs may be among them."""
    found: list[XY] = []
    for node in every(pts, "xy", "arc"):
        if node[0] == "xy":
            found += [(xy[0], -xy[1])] if len(xy := numbers(node)) == 2 else []
        elif (start := _xy(node, "start")) and (middle := _xy(node, "mid")) and (end := _xy(node, "end")):
            found += arc_through(start, middle, end)
    return found


def _arc(shape: Node, start: XY, middle: XY | None, end: XY) -> list[XY]:
    if middle is not None:
        return arc_through(start, middle, end)
    # Until version 5 "start" is the centre, "end" the begin of the arc, and "angle" its clockwise sweep on the screen.
    sweep = (numbers(first(shape, "angle")) or [0.0])[0]
    offset = rotated((end[0] - start[0], end[1] - start[1]), -sweep)
    return arc_points(end, (start[0] + offset[0], start[1] + offset[1]), start, clockwise=sweep > 0)


def _bezier(control: list[XY]) -> list[XY]:
    """Return 16 steps along a cubic Bézier curve."""
    if len(control) != 4:
        return control
    steps = [k / 16 for k in range(17)]
    weights = [((1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t**3) for t in steps]
    return [(sum(w * p[0] for w, p in zip(ws, control, strict=True)),
             sum(w * p[1] for w, p in zip(ws, control, strict=True))) for ws in weights]  # fmt: skip


def _xy(shape: Node, key: str) -> XY | None:
    found = numbers(first(shape, key))
    return (found[0], -found[1]) if len(found) >= 2 else None


def _edges(root: Node) -> Iterator[list[XY]]:
    """Yield the pieces of the outline: drawings of the board, and of footprints with an outline of their own."""
    yield from _drawing(root, "gr_", "Edge.Cuts")
    for footprint in every(root, "footprint", "module"):
        at = numbers(first(footprint, "at"))
        for piece in _drawing(footprint, "fp_", "Edge.Cuts") if len(at) >= 2 else ():
            turned = [rotated(p, at[2] if len(at) > 2 else 0.0) for p in piece]
            yield [(x + at[0], y - at[1]) for x, y in turned]
