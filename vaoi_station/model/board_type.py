"""A board type: outline, fiducials and other marks, and components in CAD coordinates."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from vaoi_station.geometry.polygon import encloses, find_crossing_edges
from vaoi_station.model.board_identity import BoardIdentity, check_places
from vaoi_station.model.frozen_model import MOST_MM, Finite, FrozenModel, Millimetres, Point, Positive, Whole
from vaoi_station.model.part_limits import BoardLimits
from vaoi_station.model.recording import Program

FoundBy = Literal["element", "attribute", "package", "name", "place"]
Look = Literal["dark", "light", "blank"]
"""How a mark looks against what surrounds it; blank: as this."""
Position = Annotated[str, Field(min_length=1, max_length=40, pattern=r"^[^\x00-\x1f\x7f/]+$")] | int
"""Position of a board on its panel. It has no "/", which separates it from the reference designator in addresses."""


class Fiducial(FrozenModel):
    """A fiducial mark of the board at known CAD coordinates."""

    name: str
    """Name of the fiducial."""
    x: Finite
    """CAD x of its centre."""
    y: Finite
    """CAD y of its centre."""
    shape: Literal["circle", "cross", "square", "diamond"] = "circle"
    """Its shape."""
    diameter: Positive
    """Diameter, or size from side to side or tip to tip."""
    kind: Literal["global", "local"] | None = None
    """Global: places the board. Local: places its components, not C, while two others place the board. Empty:
    global."""
    found_by: FoundBy | None = None
    """How the import recognised it."""
    components: tuple[str, ...] | None = None
    """Addresses of the components that a local fiducial places."""
    panel: Position | None = None
    """Position of the board of the panel that it places; components of this board follow it. Empty: of the panel, or of
    the only board."""


class OtherMark(FrozenModel):
    """A mark by which no board is placed: a fiducial of the panel, or a mark that states that a board is bad."""

    name: str
    """Name of the mark."""
    x: Finite
    """CAD x of its centre; it may lie outside the outline."""
    y: Finite
    """CAD y of its centre."""
    shape: Literal["circle", "cross", "square", "diamond"] = "circle"
    """Its shape."""
    diameter: Positive
    """Diameter, or size from side to side or tip to tip."""
    kind: Literal["panel", "bad-board"]
    """A fiducial of the panel, or the mark by which a board is crossed out."""
    found_by: FoundBy | None = None
    """How the import recognised it."""
    panel: Position | None = None
    """Of a bad-board mark: position of its board on the panel."""
    bad: Look | None = None
    """Its look on a bad board, against what surrounds it. Empty: the mark is not read."""
    good: Look | None = None
    """Its look on a good board. Empty: blank."""

    @property
    def read(self) -> bool:
        """Whether the mark is read in every run."""
        return self.kind == "bad-board" and self.bad is not None

    @model_validator(mode="after")
    def _readable(self) -> Self:
        if self.bad is None:
            return self
        if self.kind != "bad-board" or self.panel is None:
            raise ValueError(
                f"mark {self.name!r} states how it looks on a bad board: its kind must be 'bad-board', and `panel` the "
                "position of that board on the panel"
            )
        if self.bad == (self.good or "blank"):
            raise ValueError(f"mark {self.name!r} looks {self.bad} on good and on bad boards; they must differ")
        return self


def fiducials_by_board(fiducials: Sequence[Fiducial]) -> dict[str, tuple[int, ...]]:
    """Return the numbers of the fiducials of each board of a panel, by its position; local ones are of no board."""
    out: dict[str, tuple[int, ...]] = {}
    for n, f in enumerate(fiducials):
        if f.panel is not None and not (f.kind == "local" and f.components):
            out[str(f.panel)] = (*out.get(str(f.panel), ()), n)
    return out


def largest_distance(marks: Sequence[Fiducial]) -> float:
    """Return the largest distance between two fiducials, in CAD units; 0 for fewer than two."""
    places = [(f.x, f.y) for f in marks]
    return max((math.dist(a, b) for a in places for b in places), default=0.0)


ONE_LINE = r"^[^\x00-\x1f\x7f]+$"
"""Pattern of texts without control characters."""
STORED_NAME = r"^[^./\\\x00-\x1f\x7f][^/\\\x00-\x1f\x7f]{0,79}$"
"""Pattern of the names under which a station stores board types: each is the name of a file, and part of an address."""
STORED_NAME_RULE = "1 to 80 characters without slashes, control characters and leading dot"
_MAX_ENTRIES = {
    "components": 20_000,
    "fiducials": 1_000,
    "outline": 10_000,
    "fixture_marks": 10_000,
    "other_marks": 1_000,
    "cut_outs": 500,
}
"""Largest number of entries in each list of a board type."""
_MOST_HEIGHT_MM = 1000.0
MOST_POINTS = 50_000
"""Largest number of test points."""
MOST_CUT_OUT_CORNERS = 20_000
"""Largest number of corners of all cut-outs together."""
BoardTypeState = Literal["draft", "approved", "retired"]
OF_IMPORT: dict[str, Any] = {"fiducials": {"__all__": {"kind", "found_by", "components", "panel"}}}
"""Keys of the fiducials that are left out of digests; `BoardType.local_terms` has those of local ones and of boards."""
_NOT_FILMED: dict[str, Any] = OF_IMPORT | {
    "revision": True,
    "state": True,
    "cut_outs": True,
    "other_marks": True,
    "identity": True,
    "limits": True,
    "test_points": True,
    "components": {"__all__": {"package", "size_from", "fitted"}},
}
"""Keys on which no run depends. Without them the digest is that of versions that did not have them, so that drift is
watched on across an update."""
MM_PER_UNIT = {"mm": 1.0, "inch": 25.4, "mil": 0.0254}


class Visibility(FrozenModel):
    """How much of a component the good frames of a run must show.

    A value that is absent is taken from the next more general level: component, board type, `[visibility]` of
    station.toml, and in the end 0.99, 0 and false.
    """

    coverage: Annotated[Finite, Field(ge=0, le=1)] | None = None
    """Least share of the footprint that the frames show together; 0 for a component that need not be seen."""
    views: Annotated[Whole, Field(ge=0, le=1000)] | None = None
    """Least number of frames that show at least half of the footprint."""
    in_one_frame: bool | None = None
    """Whether one frame must show the whole footprint. No frame does so for a component on a seam."""

    def over(self, general: Visibility) -> Visibility:
        """Return these values, with missing ones taken from the next more general level."""
        return Visibility(
            coverage=general.coverage if self.coverage is None else self.coverage,
            views=general.views if self.views is None else self.views,
            in_one_frame=general.in_one_frame if self.in_one_frame is None else self.in_one_frame,
        )


UnseenCause = Literal["frames-unconfirmed", "frames-lost", "filming-ended", "filming-began", "seam", "beyond-view"]
"""Why the good frames show too little of a component."""

VISIBILITY = Visibility(coverage=0.99, views=0, in_one_frame=False)
"""The visibility that every component must have, unless component, board type or station ask for something else."""


class Component(FrozenModel):
    """One component. Centre and size of its footprint before rotation are in CAD units, its rotation in degrees."""

    ref: Annotated[str, Field(min_length=1, pattern=ONE_LINE)]
    """Reference designator."""
    center: Point
    """CAD coordinates of the centre of the footprint."""
    width: Positive
    """Extent of the footprint along CAD x, before rotation."""
    height: Positive
    """Extent along CAD y, before rotation."""
    rotation: Annotated[Finite, Field(ge=-36_000, le=36_000)] = 0.0
    """Degrees, counter-clockwise as seen on the top of the board, whichever way y points."""
    body_height: Annotated[Finite, Field(ge=0)] | None = None
    """Height of the part above the board."""
    panel: str | int | None = None
    """Position of its board on the panel, text or number."""
    origin: Point | None = None
    """Where the CAD system places the part, if not at its centre; only for comparison."""
    package: str | None = None
    """Name of the package."""
    size_from: Literal["file", "table", "guess"] | None = None
    """Whether the imported file states the size, or it is from a table of packages, or guessed."""
    fitted: bool | None = None
    """False if this variant of the product is made without the part."""
    visibility: Visibility | None = None
    """How much of this part the good frames of a run must show. Empty: as the board type states."""

    @property
    def address(self) -> str:
        """Unique address of the component in its board type: `panel/ref` on a panel, otherwise `ref`."""
        return self.ref if self.panel is None else f"{self.panel}/{self.ref}"


class FixtureMarkShape(FrozenModel):
    """Shape, size and polarity of the fixture marks."""

    shape: Literal["cross", "circle", "square", "diamond"] = "cross"
    """Shape of the marks."""
    size: Positive
    """Size from tip to tip, or diameter."""
    width: Positive | None = None
    """Width of one arm of a cross."""
    polarity: Literal["dark", "light"] = "light"
    """Against what surrounds them."""


class Place(FrozenModel):
    """A point with named coordinates x and y, as in JSON files."""

    x: Finite
    """X of its centre."""
    y: Finite
    """Y of its centre."""


class PointTable(FrozenModel):
    """Points that a probe can reach, in columns of equal length: a board has thousands."""

    name: tuple[Annotated[str, Field(min_length=1, max_length=200, pattern=ONE_LINE)], ...]
    """A pad as `U1-3`; no two are alike."""
    x: tuple[Finite, ...]
    """CAD x of each."""
    y: tuple[Finite, ...]
    """CAD y of each."""
    net: tuple[str, ...] | None = None
    """Net of each."""
    kind: tuple[Literal["pad", "pin", "via"], ...] | None = None
    """Kind of each; a pin goes through the board."""
    diameter: tuple[Positive | None, ...] | None = None
    """Smallest extent of the copper of each; null where it is not known."""

    @model_validator(mode="after")
    def _columns_fit(self) -> Self:
        columns = (self.name, self.x, self.y, self.net, self.kind, self.diameter)
        counts = {len(column) for column in columns if column is not None}
        if len(counts) > 1 or len(self.name) > MOST_POINTS:
            raise ValueError(f"has columns of {sorted(counts)} entries, must have equal numbers, at most {MOST_POINTS}")
        _check_unique(list(self.name), "name")
        return self


class BoardLine(FrozenModel):
    """How boards of this type run through the line, where that differs from station.toml."""

    speed_mm_s: Annotated[Positive, Field(le=1e5)] | None = None
    """Speed of the belt."""
    rail_mm: Millimetres | None = None
    """Tester coordinate of the fixed rail, across the motion."""
    tail_s: Annotated[Finite, Field(ge=0, le=3600)] | None = None
    """Time for which pulses continue after the board has left the barrier."""
    longest_board_mm: Annotated[Positive, Field(le=MOST_MM)] | None = None
    """Longest board of this type, along the motion, with its carrier."""
    pacing: Literal["time", "encoder"] | None = None
    """What spaces the rows: the controller's clock, or the belt's way as the encoder counts it."""
    row_mm: Annotated[Positive, Field(le=MOST_MM)] | None = None
    """Distance of the belt between two rows."""


class BoardType(FrozenModel):
    """The content of board.json: one side of a product, in its CAD unit and axes."""

    name: Annotated[str, Field(min_length=1, max_length=200, pattern=ONE_LINE)]
    """Name of the board type."""
    revision: Annotated[str, Field(min_length=1, max_length=40, pattern=ONE_LINE)] | None = None
    """Revision of the data, as its owner names it; every run states it."""
    state: BoardTypeState | None = None
    """Draft: armed with a warning, which is a reason of every run. Retired: refused when armed. Empty: approved."""
    unit: Literal["mm", "inch", "mil"] = "mm"
    """Unit of all numbers of the file but those of line and program."""
    y_axis: Literal["up", "down"] = "up"
    """Where CAD y points."""
    side: Literal["top", "bottom"] = "top"
    """The side that is up in the line."""
    outline: tuple[Point, ...] | None = None
    """Two opposite corners, or a polygon; fiducials outside it are refused."""
    cut_outs: tuple[tuple[Point, ...], ...] | None = None
    """Openings within the outline, polygons of three corners or more."""
    fiducials: tuple[Fiducial, ...] = ()
    """At least two, or the type is refused when it is stored, armed or stitched."""
    other_marks: tuple[OtherMark, ...] | None = None
    """Marks that place no board."""
    components: tuple[Component, ...] = ()
    """The parts; two of one address (panel, ref) are refused."""
    fixture_mark: FixtureMarkShape | None = None
    """Look of the marks of the fixture."""
    fixture_marks: tuple[Place, ...] = ()
    """Centres of these marks, for fiducial-based stitching."""
    visibility: Visibility | None = None
    """How much of every part a run must show. Empty: as station.toml states."""
    program: Program | None = None
    """Light, exposure and gain of the rows, in turn; None: as station.toml states."""
    line: BoardLine | None = None
    """Belt speed, rail, tail and longest board, where they differ from station.toml."""
    identity: BoardIdentity | None = None
    """The codes that state the id of a board; None: boards of this type have none."""
    test_points: PointTable | None = None
    """Points of this side that a probe reaches, in columns; at most 50,000."""
    limits: BoardLimits | None = None
    """Limits beyond which the measures of parts are marked; None: none are marked."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        # Counts are checked first, because the time for the checks below grows with the square of the counts.
        _check_sizes(self)
        _check_unique([c.address for c in self.components], "components")
        _check_unique([f.name for f in self.fiducials], "fiducials")
        if self.outline is not None:
            if len(self.outline) < 2:
                raise ValueError("outline has one point; it is two opposite corners or a polygon")
            low, high = self.extent()
            if (high <= low).any():
                raise ValueError(f"outline has no area: from {low.tolist()} to {high.tolist()}")
            if edges := find_crossing_edges(self.outline):
                raise ValueError(f"outline crosses itself: its edges from corners {edges[0]} and {edges[1]} meet")
            # Converted once: a conversion for each fiducial would take longer than the test.
            corners = np.array(self.outline, dtype=np.float64)
            for f in self.fiducials:
                if not encloses(corners, (f.x, f.y)):
                    raise ValueError(
                        f"fiducial {f.name!r} at ({f.x}, {f.y}) lies outside the outline "
                        f"{low.tolist()} … {high.tolist()} {self.unit}"
                    )
        _check_cut_outs(self)
        _check_positions(self)
        if self.identity is not None and self.identity.places:
            check_places(self.identity, *self.extent(), 1.0 / self.mm_per_unit)
        if self.fixture_marks and self.fixture_mark is None:
            raise ValueError("fixture_marks are given, but not their shape: fixture_mark is missing")
        return self

    @property
    def mm_per_unit(self) -> float:
        """Size of one CAD unit in mm."""
        return MM_PER_UNIT[self.unit]

    @property
    def mirrors(self) -> bool:
        """Whether the mapping from CAD to image coordinates changes handedness (docs/formats.md).

        It does so if either the y axis points up or the bottom side is filmed, but not if both are true.
        """
        return (self.y_axis == "up") != (self.side == "bottom")

    @property
    def local_fiducials(self) -> frozenset[int]:
        """Numbers of the fiducials that place components only; none if fewer than two others would place the board.

        A local fiducial none of whose components exists counts as a global one.
        """
        named = {n: f.components for n, f in enumerate(self.fiducials) if f.kind == "local" and f.components}
        if not named:
            return frozenset()
        present = {c.address for c in self.components}
        local = frozenset(n for n, components in named.items() if not present.isdisjoint(components))
        return local if len(self.fiducials) - len(local) >= 2 else frozenset()

    @property
    def board_fiducials(self) -> dict[str, tuple[int, ...]]:
        """Numbers of the fiducials of each board of a panel, by its position; local fiducials are none of them."""
        return fiducials_by_board(self.fiducials)

    def board_of_c(self, found: Collection[int], fixture_marks: int = 0) -> str | None:
        """Return the position of the board of a panel whose fiducials alone determine C; None if none does.

        It is the board with the largest distance between two fiducials that are found. The panel's fiducials take its
        place, together with the fixture marks around the panel, if at least two of these are found.

        Args:
            found: numbers of the fiducials that were found.
            fixture_marks: number of fixture marks that were found.
        """
        boards = self.board_fiducials
        of_panel = set(found).difference(self.local_fiducials, *boards.values())
        if not boards or len(of_panel) + fixture_marks >= 2:
            return None
        seen = {position: [self.fiducials[n] for n in at if n in found] for position, at in boards.items()}
        spans = {position: largest_distance(marks) for position, marks in seen.items()}
        widest = max(spans, key=lambda position: spans[position])
        return widest if spans[widest] > 0 else None

    def apart_from_c(self, found: Collection[int], fixture_marks: int = 0) -> frozenset[int]:
        """Return the numbers of the fiducials that have no part in C: local ones, and those of boards of a panel.

        Where one board determines C, all others have no part in it, nor has a single fiducial of the panel. Arguments
        as of `board_of_c`.
        """
        boards, local = self.board_fiducials, self.local_fiducials
        of_boards = frozenset(n for numbers in boards.values() for n in numbers)
        of_panel = set(found) - of_boards - local
        if (position := self.board_of_c(found, fixture_marks)) is not None:
            return local | (of_boards - frozenset(boards[position])) | of_panel
        return local | of_boards if len(of_panel) + fixture_marks >= 2 else local

    @property
    def local_terms(self) -> str:
        """Text of what positions owe to fiducials of components and of boards; empty without any.

        Digests of board types without such fiducials are then those of earlier versions.
        """
        local = {self.fiducials[n].name: self.fiducials[n].components for n in sorted(self.local_fiducials)}
        boards = {position: [self.fiducials[n].name for n in at] for position, at in self.board_fiducials.items()}
        return (json.dumps(local) if local else "") + (json.dumps(boards) if boards else "")

    def filmed_digest(self) -> str:
        """Return a digest of everything on which runs depend.

        It stays when a board type is approved, or when its fiducials are described differently.
        """
        # Keys that older versions did not have count only where a board type states them.
        unset = {key for key in ("pacing", "row_mm") if self.line is not None and getattr(self.line, key) is None}
        left_out = {**_NOT_FILMED, "line": unset} if unset else _NOT_FILMED
        text = self.model_dump_json(exclude=left_out) + self.local_terms
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def extent(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the lowest and the highest corner of the board's extent, in CAD units.

        The extent is that of the outline or, without an outline, that of all fiducials and footprints.
        """
        points: list[Any] = [*(self.outline or ())]
        if not points:
            points = [(f.x, f.y) for f in self.fiducials]
            points += [corner for c in self.components for corner in self.footprint(c)]
        p = np.array(points, dtype=np.float64).reshape(-1, 2)
        if not len(p):
            raise ValueError(f"board type {self.name!r} has neither outline nor fiducials nor components")
        return p.min(0), p.max(0)

    def component(self, address: str) -> Component | None:
        """Return the component with the given address, or None if there is none."""
        return next((c for c in self.components if c.address == address), None)

    def footprint(self, component: Component) -> NDArray[np.float64]:
        """Return the four corners (4, 2) of a component's rotated footprint, in CAD coordinates."""
        # Rotation is counter-clockwise with CAD "up" shown up, which is a negative angle if the y axis points down.
        a = math.radians(component.rotation if self.y_axis == "up" else -component.rotation)
        half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (component.width / 2, component.height / 2)
        turn = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
        return np.asarray(half @ turn.T + component.center)


def _check_sizes(board: BoardType) -> None:
    """Raise ValueError if a board type has more entries, or other sizes or distances, than any real board."""
    for key, most in _MAX_ENTRIES.items():
        if len(getattr(board, key) or ()) > most:
            raise ValueError(f"{key} has {len(getattr(board, key))} entries, the limit is {most}")
    mm = board.mm_per_unit
    for key, x, y in _coordinates(board):
        if not max(abs(x), abs(y)) * mm <= MOST_MM:
            raise ValueError(f"{key} is at ({x:g}, {y:g}) {board.unit}, must be within ±{MOST_MM:g} mm of the origin")
    for c in board.components:
        if not 0.01 <= min(c.width, c.height) * mm <= max(c.width, c.height) * mm <= 2000:
            raise ValueError(f"component {c.address!r} is {c.width}×{c.height} {board.unit}, must be 0.01 to 2000 mm")
        if c.body_height is not None and not c.body_height * mm <= _MOST_HEIGHT_MM:
            limit = f"must be at most {_MOST_HEIGHT_MM:g} mm"
            raise ValueError(f"component {c.address!r} has body_height {c.body_height:g} {board.unit}, {limit}")
    shape = board.fixture_mark
    if shape is not None and not 0.05 <= shape.size * mm <= 50:
        raise ValueError(f"fixture_mark has size {shape.size:g} {board.unit}, must be 0.05 to 50 mm")
    if shape is not None and shape.width is not None and not shape.width <= shape.size:
        raise ValueError(f"fixture_mark has width {shape.width:g}, must be at most its size, {shape.size:g}")
    places = np.array([(f.x, f.y) for f in board.fiducials], dtype=np.float64).reshape(-1, 2)
    for n, f in enumerate(board.fiducials):
        if not 0.05 <= f.diameter * mm <= 50:
            raise ValueError(f"fiducial {f.name!r} has diameter {f.diameter} {board.unit}, must be 0.05 to 50 mm")
        # Two fiducials at one place make their assignment to detections ambiguous.
        if (np.hypot(*(places[:n] - places[n]).T) * mm < 0.1).any():
            raise ValueError(f"fiducial {f.name!r} is at the place of another fiducial; they must be 0.1 mm apart")


def _coordinates(board: BoardType) -> Iterator[tuple[str, float, float]]:
    """Yield all coordinates of a board type, in its unit, with the names of their keys."""
    yield from ((f"outline.{n}", x, y) for n, (x, y) in enumerate(board.outline or ()))
    yield from ((f"fiducial {f.name!r}", f.x, f.y) for f in board.fiducials)
    yield from ((f"component {c.address!r}", *c.center) for c in board.components)
    yield from ((f"the origin of component {c.address!r}", *c.origin) for c in board.components if c.origin)
    yield from ((f"other mark {m.name!r}", m.x, m.y) for m in board.other_marks or ())
    yield from ((f"fixture_marks.{n}", m.x, m.y) for n, m in enumerate(board.fixture_marks))


def _check_cut_outs(board: BoardType) -> None:
    """Raise ValueError if a cut-out is no polygon within the outline."""
    cut_outs = board.cut_outs or ()
    if cut_outs and board.outline is None:
        raise ValueError("cut_outs are given, but outline is missing")
    if (count := sum(map(len, cut_outs))) > MOST_CUT_OUT_CORNERS:
        raise ValueError(f"cut_outs have {count} corners, the limit is {MOST_CUT_OUT_CORNERS}")
    if not cut_outs:
        return
    low, high = board.extent()
    for n, corners in enumerate(cut_outs):
        if len(corners) < 3:
            raise ValueError(f"cut_outs.{n} has {len(corners)} corners, a polygon has at least 3")
        points = np.array(corners, dtype=np.float64)
        if (points < low).any() or (points > high).any():
            raise ValueError(f"cut_outs.{n} lies outside the outline {low.tolist()} … {high.tolist()} {board.unit}")


def _check_positions(board: BoardType) -> None:
    """Raise ValueError if a fiducial belongs to a board without components, or an address may be of two boards."""
    of_parts = {str(c.panel) for c in board.components if c.panel is not None}
    marks = [("fiducial", f.name, f.panel) for f in board.fiducials]
    marks += [("mark", m.name, m.panel) for m in board.other_marks or ()]
    for what, name, position in marks:
        if position is not None and str(position) not in of_parts:
            raise ValueError(
                f"{what} {name!r} belongs to position {str(position)!r} of the panel, which has no components; give "
                "these components the same `panel`"
            )
    positions = board.board_fiducials
    for c in board.components if positions else ():
        if c.panel is None and "/" in c.ref and c.ref.partition("/")[0] in positions:
            raise ValueError(
                f"component {c.ref!r} belongs to no position of the panel, but its name begins like that of one; give "
                "`panel` and `ref` apart"
            )


def _check_unique(names: list[str], what: str) -> None:
    """Raise ValueError if a name occurs twice. `what` names the list in the message."""
    if repeated := [name for name, count in Counter(names).items() if count > 1]:
        raise ValueError(f"{what} contains {repeated[0]!r} twice; names must be unique")
