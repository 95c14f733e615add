"""The neutral model of a design: what all formats of board data have in common.

Lengths are in mm. x points right and y points up as seen from the top of the board. Rotations are in degrees,
counter-clockwise as seen from the top, also for parts on the bottom.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple

from pydantic import Field

from vaoi_station.model import Strict
from vaoi_station.model.reason import Note

Side = Literal["top", "bottom"]
XY = tuple[float, float]
Contour = tuple[XY, ...]
LEAST_DRAWING = 0.5
"""A drawing of a body is at least this share of its pins, along both axes."""
KICAD_COURTYARD_MM = 0.25
"""Usual distance of a courtyard from body and pads (KiCad library convention F5.3)."""
SizeFrom = Literal["file", "table", "guess"]
MarkKind = Literal["global", "local", "panel", "bad-board"]
FoundBy = Literal["element", "attribute", "package", "name", "place"]
PointKind = Literal["pad", "pin", "via"]


@dataclass(frozen=True)
class Box:
    """An axis-parallel rectangle in the frame of a part: relative to its origin, before its rotation, mm."""

    low: XY
    high: XY

    @staticmethod
    def of_size(width: float, height: float) -> Box:
        """Return a box about the origin."""
        return Box((-width / 2, -height / 2), (width / 2, height / 2))

    @property
    def center(self) -> XY:
        """Centre of the box."""
        return (self.low[0] + self.high[0]) / 2, (self.low[1] + self.high[1]) / 2

    @property
    def size(self) -> XY:
        """Extent along x and y."""
        return self.high[0] - self.low[0], self.high[1] - self.low[1]

    def mirrored(self) -> Box:
        """Return the box with x reversed, as it is seen from the other side."""
        return Box((-self.high[0], self.low[1]), (-self.low[0], self.high[1]))

    def shrunk(self, margin: float) -> Box:
        """Return the box without a margin on every side; at least a tenth of each side remains."""
        (x, y), (w, h) = self.center, self.size
        half = (max(w / 2 - margin, w / 20), max(h / 2 - margin, h / 20))
        return Box((x - half[0], y - half[1]), (x + half[0], y + half[1]))

    def corners(self, at: Placement) -> list[XY]:
        """Return the four corners of the box at a place."""
        return [at.apply((x, y)) for x in (self.low[0], self.high[0]) for y in (self.low[1], self.high[1])]


def box_around(points: Iterable[XY]) -> Box | None:
    """Return the smallest box around points; None if they enclose no area."""
    if not (points := list(points)):
        return None
    low, high = extent(points)
    return Box(low, high) if min(high[0] - low[0], high[1] - low[1]) >= 1e-6 else None


def body_of(drawing: Box | None, pins: Box | None) -> Box | None:
    """Return the body from the drawing of a package and the box of its pins.

    A drawing that is much smaller than the pins is a mark of pin 1 or a part of a silkscreen: then both together count.
    """
    if drawing is None or pins is None:
        return drawing or pins
    if all(d >= LEAST_DRAWING * p for d, p in zip(drawing.size, pins.size, strict=True)):
        return drawing
    return box_around([drawing.low, drawing.high, pins.low, pins.high])


@dataclass(frozen=True)
class Part:
    """One placed part of a design."""

    ref: str
    side: Side
    origin: XY
    """Where the CAD system places the part."""
    rotation: float
    package: str = ""
    value: str = ""
    box: Box | None = None
    """The body; for a part on the bottom as it is seen from the top. None if the file does not state it."""
    size_from: SizeFrom = "file"
    body_height: float | None = None
    fitted: bool = True
    in_bom: bool = True
    """False if the file excludes the part from the bill of materials; it may be placed, as a fiducial is."""
    mark_diameter: float | None = None
    """Extent of the first pad, which is the diameter of the mark if the part is a fiducial."""
    is_mark: bool = False
    """Whether the file itself says that the part is a fiducial."""
    mark_kind: MarkKind | None = None
    """The kind that an attribute of the file states; None: names decide."""
    panel: str | None = None
    """Position on the panel of the board that the part is on."""
    line: int | None = field(default=None, compare=False)
    """Line of the file that places the part, where the format has lines."""

    @property
    def address(self) -> str:
        """Designator, on a panel behind the position of its board, as in board types."""
        return self.ref if self.panel is None else f"{self.panel}/{self.ref}"

    @property
    def center(self) -> XY:
        """Centre of the body; the origin if no body is known."""
        if self.box is None:
            return self.origin
        a, (x, y) = math.radians(self.rotation), self.box.center
        c, s = math.cos(a), math.sin(a)
        return self.origin[0] + c * x - s * y, self.origin[1] + s * x + c * y


@dataclass(frozen=True)
class Mark:
    """A fiducial, or another mark of the board or its panel."""

    name: str
    side: Side | None
    """None: on both sides."""
    at: XY
    diameter: float | None = None
    kind: MarkKind = "global"
    found_by: FoundBy = "element"
    components: tuple[str, ...] = ()
    """Designators of the parts that a local fiducial belongs to; on a panel their addresses."""
    panel: str | None = None
    """Position on the panel of the board that the mark belongs to."""


class NetPoint(NamedTuple):
    """A pad or via of a net, which a probe can reach on some sides."""

    ref: str
    """The part's designator, of IPC-D-356 its first letters; empty for a via."""
    pin: str
    net: str
    at: XY
    on_top: bool
    """Whether there is copper on the top that solder mask does not cover, as far as the file states its mask."""
    on_bottom: bool
    kind: PointKind = "pad"
    """A pin goes through the board."""
    diameter: float | None = None
    """Smallest extent of the copper, mm."""
    name: str = ""
    """A name of its own: that of the file, or as `numbered` makes it."""

    def on_side(self, side: Side) -> bool:
        """Return whether a probe reaches it on a side."""
        return self.on_top if side == "top" else self.on_bottom


@dataclass(frozen=True)
class Placement:
    """The way from one frame to another: mirror x, rotate, shift."""

    mirrored: bool = False
    degrees: float = 0.0
    shift: XY = (0.0, 0.0)

    @cached_property
    def _turn(self) -> tuple[float, float]:
        a = math.radians(self.degrees)
        return math.cos(a), math.sin(a)

    def apply(self, point: XY) -> XY:
        """Return a point of the first frame in the second."""
        (c, s), x, y = self._turn, -point[0] if self.mirrored else point[0], point[1]
        return c * x - s * y + self.shift[0], s * x + c * y + self.shift[1]

    def undo(self, point: XY) -> XY:
        """Return a point of the second frame in the first."""
        (c, s), x, y = self._turn, point[0] - self.shift[0], point[1] - self.shift[1]
        x, y = c * x + s * y, c * y - s * x
        return (-x if self.mirrored else x), y

    def within(self, outer: Placement) -> Placement:
        """Return the way through both: this one first, then the outer one."""
        turn = -self.degrees if outer.mirrored else self.degrees
        return Placement(self.mirrored != outer.mirrored, turn + outer.degrees, outer.apply(self.shift))


class ImportedColumn(Strict):
    """A column of a centroid file whose content was recognised."""

    name: str
    number: int = Field(description="From 1.")
    header: str | None = None


class ImportedTable(Strict):
    """What was recognised of a centroid file."""

    delimiter: str
    unit: str
    unit_from: str = Field(description="What states the unit.")
    columns: list[ImportedColumn]
    headers: list[str] = Field(default=[], description="Header of every column.")
    all_on: Side | None = Field(default=None, description="The side of all parts, as it was given.")

    def has(self, name: str) -> bool:
        """Return whether a column was recognised."""
        return any(column.name == name for column in self.columns)


@dataclass(frozen=True)
class PlacedBoard:
    """A board on a panel, or what belongs to a part of the panel; mirrored, it lies upside down."""

    name: str
    """What names of its marks begin with; of a board its position."""
    position: str | None
    """Position on the panel; None for what belongs to no board."""
    design: Design
    at: Placement


@dataclass(frozen=True)
class Design:
    """The parts and the outline of a board, from one file."""

    name: str
    format: str
    parts: tuple[Part, ...]
    outline: Contour = ()
    """The outer contour; empty if the file has none."""
    cut_outs: tuple[Contour, ...] = ()
    islands: tuple[Contour, ...] = ()
    """Contours within cut-outs: the cut-outs of a board that lies in a frame."""
    marks: tuple[Mark, ...] = ()
    """Fiducials that are no parts."""
    table: ImportedTable | None = None
    boards: tuple[PlacedBoard, ...] = ()
    """Of a panel: its boards. Parts, outline and marks are then the panel's."""
    step: str | None = None
    """Of ODB++ and IPC-2581: the step that was read."""
    steps: tuple[str, ...] = ()
    """All steps of the file that can be read."""
    net_points: tuple[NetPoint, ...] = ()
    """Pads and vias of both sides, of the file itself or of a netlist that was joined."""
    notes: tuple[Note, ...] = ()
    """What the user must know about this import, a sentence each."""

    def with_notes(self, *notes: Note) -> Design:
        """Return the design with further notes."""
        return replace(self, notes=(*self.notes, *notes))

    def parts_on(self, side: Side) -> list[Part]:
        """Return the parts of one side."""
        return [part for part in self.parts if part.side == side]


def extent(points: Iterable[XY]) -> tuple[XY, XY]:
    """Return the lowest and the highest corner of the rectangle around points."""
    xs, ys = zip(*points, strict=True)
    return (min(xs), min(ys)), (max(xs), max(ys))


def rotated(point: XY, degrees: float) -> XY:
    """Return a point rotated counter-clockwise about the origin."""
    return Placement(False, degrees).apply(point)


def normalised(degrees: float) -> float:
    """Return an angle in [0, 360), with rounding errors of 10⁻⁶° removed."""
    found = round(degrees % 360, 6)
    return 0.0 if found == 360 else found


def angle_between(a: float, b: float) -> float:
    """Return the smaller angle between two directions, degrees."""
    return abs((a - b + 180) % 360 - 180)


def noted(code: str, text: str, **values: object) -> Note:
    """Return a note whose text has its values in braces; of a list of names the first eight are shown."""
    shown = {key: some(value) if isinstance(value, list) else value for key, value in values.items()}
    return Note(code, text.format(**shown), **shown)


def some(names: Sequence[str], most: int = 8) -> str:
    """Return the first names of a list: `R1, R2 and 3 more`."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def places(points: Iterable[Sequence[float]]) -> str:
    """Return the first places of a list, in mm: `(10, 20), (30, 5) and 3 more`."""
    return some([f"({x:.6g}, {y:.6g})" for x, y in points], 4)
