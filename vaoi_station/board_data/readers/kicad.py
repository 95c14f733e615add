"""Read KiCad boards (`.kicad_pcb`, versions 5 to 10).

KiCad's y points down, its rotations are counter-clockwise as seen on the screen from the top. A footprint on the bottom
is stored as it is seen from the top. Description of the format: dev-docs.kicad.org, "PCB file format".
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from operator import mul
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
    NetPoint,
    Part,
    Placement,
    PointKind,
    Side,
    body_of,
    box_around,
    normalised,
    noted,
    rotated,
)
from vaoi_station.board_data.marks import kind_by_name
from vaoi_station.board_data.net_points import numbered
from vaoi_station.board_data.readers.sexpr import Node, every, first, numbers, parse_sexpr, text_of
from vaoi_station.board_data.readers.table_words import is_fitted
from vaoi_station.board_data.source_text import decode
from vaoi_station.errors import InputError

_MARK_PROPERTIES: dict[str, MarkKind] = {"pad_prop_fiducial_glob": "global", "pad_prop_fiducial_loc": "local"}
_UNFITTED = frozenset({"DNP", "DNI", "DNF"})
"""Names of properties by which users state that a part is not fitted."""
_COPPER_TYPES = ("signal", "power", "mixed", "jumper")
"""Types of copper layers in the table of layers."""
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
    _name_outer_copper(root)
    footprints = [_Footprint(node) for node in every(root, "footprint", "module")]
    placed = [(footprint, footprint.part()) for footprint in footprints]
    parts = [part for _, part in placed if part is not None]
    edges = [*_drawing(root, "gr_", "Edge.Cuts"), *(piece for footprint in footprints for piece in footprint.edges())]
    contours = find_contours(edges, "Edge.Cuts")
    notes = []
    if variants := [text_of(v, "name") for v in every(first(root, "variants"), "variant")]:
        # Version 10. Footprints state what differs in a variant; the file does not state which one is current.
        text = "the file has assembly variants ({names}); the default one was read."
        notes.append(noted("variant-read", text, names=", ".join(variants), variant=""))
    if unplaced := len(placed) - len(parts):
        text = "{count} footprints are not for placement, or have no designator; they were left out."
        notes.append(noted("footprints-left-out", text, count=unplaced))
    return Design(
        name=text_of(first(root, "title_block"), "title") or path.stem,
        format="kicad",
        parts=tuple(parts),
        outline=contours.outline,
        cut_outs=contours.others,
        islands=contours.islands,
        marks=tuple(mark for footprint, part in placed for mark in footprint.marks(part)),
        net_points=numbered([*(p for footprint in footprints for p in footprint.net_points()), *_vias(root)]),
        notes=(*notes, *contours.notes),
    )


def _name_outer_copper(root: Node) -> None:
    """Give the outer copper layers their usual names; until version 5, files have those of the user everywhere."""
    # From the front to the back in all versions that need it; their numbers differ.
    rows = [n for n in first(root, "layers")[1:] if isinstance(n, list) and len(n) > 2 and n[2] in _COPPER_TYPES]
    stated = [str(row[1]) for row in rows]
    outer = {stated[0]: "F.Cu", stated[-1]: "B.Cu"} if len(stated) > 1 else {}
    names = {name: usual for name, usual in outer.items() if usual not in stated}
    nodes = [root] if names else []
    while nodes:
        node = nodes.pop()
        if node[:1] in (["layer"], ["layers"]):
            node[1:] = [names.get(word, word) if isinstance(word, str) else word for word in node[1:]]
        nodes += (n for n in node if isinstance(n, list))


class _Footprint:
    """A footprint on the board."""

    def __init__(self, node: Node) -> None:
        self.node, self.pads, at = node, list(every(node, "pad")), numbers(node, "at")
        self.has_place = len(at) > 1
        self.turn = at[2] if len(at) > 2 else 0.0
        self.at = Placement(False, self.turn, (at[0], -at[1])) if self.has_place else Placement()
        self.side: Side = "bottom" if text_of(node, "layer").startswith("B.") else "top"
        self.properties = {str(n[1]): str(n[2]) for n in every(node, "property") if len(n) > 2}
        self.ref, self.value = self._text("reference"), self._text("value")
        self.name = str(node[1]) if len(node) > 1 and not isinstance(node[1], list) else ""
        self.is_mark = "fiducial" in f"{node[1:2]} {text_of(node, 'tags')}".lower()
        self.marked = [(p, kind) for p in self.pads if (kind := _MARK_PROPERTIES.get(text_of(p, "property")))]
        """The pads whose property says that they are fiducials."""
        sizes = (numbers(pad, "size") for pad in self.pads)
        self.diameter = next((max(size) for size in sizes if size and max(size) > 0), None)
        """That of the copper of a fiducial."""

    def _text(self, kind: str) -> str:
        """Return the reference or the value: a property since version 8, a text before."""
        stated = (str(n[2]) for n in every(self.node, "property") if len(n) > 2 and str(n[1]).lower() == kind)
        texts = (str(n[2]) for n in every(self.node, "fp_text") if len(n) > 2 and n[1] == kind)
        return next(stated, next(texts, ""))

    def part(self) -> Part | None:
        """Return the part; None if it is none that is placed."""
        attributes = {str(a) for node in every(self.node, "attr") for a in node[1:]}
        not_placed = not self.ref or self.ref.startswith("#") or not self.has_place
        if not_placed or attributes & {"virtual", "exclude_from_pos_files"}:
            return None
        # Version 7 has the property "dnp" without a value, older ones only what users write into value or fields.
        stated = [(name, cell) for name, cell in self.properties.items() if name.upper() in _UNFITTED]
        unfitted = "dnp" in attributes or self.properties.get("dnp", "no") == ""
        return Part(
            ref=self.ref,
            side=self.side,
            origin=self.at.shift,
            rotation=normalised(self.turn),
            package=self.name.rpartition(":")[2],
            value=self.value,
            box=self._body(),
            fitted=not unfitted
            and is_fitted("", "", (self.value,))
            and all(is_fitted(cell, name, "") for name, cell in stated),
            in_bom=not ("exclude_from_bom" in attributes or "exclude_from_bom" in self.properties),
            is_mark=self.is_mark,
            mark_kind=self.marked[0][1] if len(self.pads) == 1 and self.marked else None,
            mark_diameter=self.diameter,
        )

    def marks(self, part: Part | None) -> Iterator[Mark]:
        """Yield the fiducials that are no placed part of their own."""
        if not self.has_place:
            return
        if len(self.pads) > 1:
            for n, (pad, kind) in enumerate(self.marked):
                where, size = numbers(pad, "at"), numbers(pad, "size")
                if len(where) >= 2 and size:
                    of = (part.ref,) if part is not None and kind == "local" else ()
                    at = self.at.apply((where[0], -where[1]))
                    yield Mark(f"{self.ref}.FID{n + 1}", self.side, at, max(size), kind, "attribute", of)
        elif part is None and self.pads and self.is_mark:
            kind = self.marked[0][1] if self.marked else kind_by_name(self.ref, str(self.node[1]))
            yield Mark(self.ref or "FID", self.side, self.at.shift, self.diameter, kind, "package")

    def net_points(self) -> Iterator[NetPoint]:
        """Yield the pads with copper on an outer layer."""
        for pad in self.pads if self.has_place else ():
            where, size, layers = _sound(pad, "at"), _sound(pad, "size"), first(pad, "layers")[1:]
            words = [str(word) for word in pad[1:3]]
            copper = any(_has(layers, s, "Cu") for s in "FB")
            top, bottom = (_has(layers, s, "Cu") and _has(layers, s, "Mask") for s in "FB")
            if not copper or len(where) < 2 or len(words) < 2 or words[1] == "np_thru_hole":
                continue
            kind: PointKind = "pin" if words[1] == "thru_hole" else "pad"
            at, diameter = self.at.apply(self._copper_at(pad, where)), min(size, default=0.0)
            yield NetPoint(self.ref, words[0], _net(pad, {}), at, top, bottom, kind, diameter if diameter > 0 else None)

    def _copper_at(self, pad: Node, where: list[float]) -> XY:
        """Return the middle of a pad's copper, which may lie beside the place of a pad without a hole."""
        (x, y), offset = (where[0], -where[1]), _sound(first(pad, "drill"), "offset")
        if len(offset) < 2 or pad[2] == "thru_hole":
            return x, y
        dx, dy = rotated((offset[0], -offset[1]), (where[2] if len(where) > 2 else 0.0) - self.turn)
        return x + dx, y + dy

    def edges(self) -> Iterator[list[XY]]:
        """Yield the pieces of an outline of its own."""
        for piece in _drawing(self.node, "fp_", "Edge.Cuts") if self.has_place else ():
            yield [self.at.apply(point) for point in piece]

    def _body(self) -> Box | None:
        """Return the body: the drawing of the fabrication layer, else the courtyard without its margin, else the pads.

        Without both layers, the silkscreen counts with the pads.
        """
        layer = "B" if self.side == "bottom" else "F"
        pads = box_around(p for pad in self.pads for p in self._corners(pad))
        drawn, courtyard, silkscreen = (
            box_around(p for piece in _drawing(self.node, "fp_", f"{layer}.{name}") for p in piece)
            for name in ("Fab", "CrtYd", "SilkS")
        )
        if drawn is not None and _is_body(drawn, pads):
            return drawn
        if courtyard is not None and _is_body(courtyard, pads):
            return courtyard.shrunk(KICAD_COURTYARD_MM)
        return body_of(silkscreen, pads)

    def _corners(self, pad: Node) -> list[XY]:
        """Return the corners of a pad in the frame of the footprint. Its own angle includes that of the footprint."""
        at, size = numbers(pad, "at"), numbers(pad, "size")
        if len(at) < 2 or len(size) < 2:
            return []
        turn = (at[2] if len(at) > 2 else 0.0) - self.turn
        return Box.of_size(size[0], size[1]).corners(Placement(False, turn, (at[0], -at[1])))


def _sound(node: Node, name: str) -> list[float]:
    """Return the numbers of a list; none if one is no number that is possible: pads and vias refuse no file."""
    try:
        return numbers(node, name)
    except InputError:
        return []


def _has(layers: Node, side: str, kind: str) -> bool:
    return any(f"{at}.{kind}" in layers for at in (side, "*", "F&B"))


def _net(node: Node, names: dict[str, str]) -> str:
    """Return the name of a net: `(net 3 "GND")` of pads, `(net 3)` of vias; since version 10 `(net "GND")`."""
    words = [str(word) for word in first(node, "net")[1:]]
    return "" if not words else words[-1] if len(words) > 1 else names.get(words[0], words[0])


def _vias(root: Node) -> Iterator[NetPoint]:
    """Yield the vias. Unless the file states that mask leaves them open, it covers them."""
    setup = first(root, "setup")
    names = {str(node[1]): str(node[2]) for node in every(root, "net") if len(node) > 2}
    open_by_plot = text_of(first(setup, "pcbplotparams"), "viasonmask") in ("true", "yes")
    usual = _tented(setup, dict.fromkeys(("front", "back"), not open_by_plot))
    for via in every(root, "via"):
        where, size, layers = _sound(via, "at"), _sound(via, "size"), first(via, "layers")[1:]
        if len(where) < 2:
            continue
        tented = _tented(via, usual)
        sides = (_has(layers, "F", "Cu") and not tented["front"], _has(layers, "B", "Cu") and not tented["back"])
        diameter = size[0] if size and size[0] > 0 else None
        yield NetPoint("", "", _net(via, names), (where[0], -where[1]), *sides, "via", diameter)


def _tented(node: Node, usual: dict[str, bool]) -> dict[str, bool]:
    """Return the sides on which mask covers vias: `(tenting front)`, since version 10 `(tenting (front yes))`."""
    stated = first(node, "tenting")[1:]
    if not stated:
        return usual
    by_words = {word: word in stated for word in usual}
    said = {str(n[0]): str(n[1]) for n in stated if isinstance(n, list) and len(n) > 1}
    return by_words | {word: said[word] == "yes" for word in usual if said.get(word) in ("yes", "no")}


def _is_body(drawing: Box, pads: Box | None) -> bool:
    """Return whether a drawing is large enough for a body, and no mark of pin 1; pads may reach far along one axis."""
    if pads is None:
        return True
    least, most = sorted(d / p for d, p in zip(drawing.size, pads.size, strict=True))
    return least >= _LEAST_BODY and most >= LEAST_DRAWING


def _drawing(node: Node, prefix: str, layer: str) -> Iterator[list[XY]]:
    """Yield lines and arcs of a drawing on a layer as points, y up. In a footprint they are relative to its origin."""
    kinds = ("line", "arc", "circle", "rect", "poly", "curve")
    for shape in every(node, *(prefix + kind for kind in kinds)):
        if text_of(shape, "layer") != layer:
            continue
        kind = str(shape[0]).removeprefix(prefix)
        start, end, center = (_xy(shape, key) for key in ("start", "end", "center"))
        if kind == "circle" and center and end:
            yield circle_points(center, math.dist(center, end))
        elif kind in ("line", "rect", "arc") and start and end:
            if kind == "arc":
                yield _arc(shape, start, end)
            else:
                yield [start, end] if kind == "line" else _rectangle(start, end, (*numbers(shape, "radius"), 0.0)[0])
        elif kind in ("poly", "curve") and (corners := _points(first(shape, "pts"))):
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


def _arc(shape: Node, start: XY, end: XY) -> list[XY]:
    if (middle := _xy(shape, "mid")) is not None:
        return arc_through(start, middle, end)
    # Until version 5 "start" is the centre, "end" the begin of the arc, and "angle" its clockwise sweep on the screen.
    sweep = (*numbers(shape, "angle"), 0.0)[0]
    offset = rotated((end[0] - start[0], end[1] - start[1]), -sweep)
    return arc_points(end, (start[0] + offset[0], start[1] + offset[1]), start, clockwise=sweep > 0)


def _bezier(control: list[XY]) -> list[XY]:
    """Return 16 steps along a cubic Bézier curve."""
    if len(control) != 4:
        return control
    steps = [k / 16 for k in range(17)]
    weights = [((1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t**3) for t in steps]
    x, y = zip(*control, strict=True)
    return [(sum(map(mul, ws, x)), sum(map(mul, ws, y))) for ws in weights]


def _xy(shape: Node, key: str) -> XY | None:
    found = numbers(shape, key)
    return (found[0], -found[1]) if len(found) >= 2 else None
