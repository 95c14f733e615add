"""Panels: several boards in one piece, from the step-and-repeat blocks of a file, or repeated as the user says.

The boards of a panel have the positions "1", "2", … in the order of the blocks; in a block along x first, then along y.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from heapq import nlargest
from typing import get_args

from vaoi_station.board_data.contours import area
from vaoi_station.board_data.conversion import MOST_CUT_OUTS, MOST_OUTLINE_POINTS
from vaoi_station.board_data.design import XY, Design, Mark, Part, PlacedBoard, Placement, Side, normalised
from vaoi_station.board_data.marks import find_marks
from vaoi_station.errors import InputError
from vaoi_station.geometry.polygon import encloses
from vaoi_station.model.frozen_model import MOST_MM

MOST_BOARDS = 1_000
"""A panel of 250 × 330 mm has 1,000 boards if each is 9 mm square."""
MOST_PARTS = 40_000
"""Largest number of parts on both sides of a panel: twice that of the components of a board type."""
MOST_LEVELS = 8
"""Largest number of steps that contain one another; a panel of arrays of boards has three."""


@dataclass(frozen=True)
class Repeat:
    """A block of step-and-repeat: one step at the places of a grid."""

    step: str
    first: XY
    """Where the datum of the step lies at the first place."""
    pitch: XY
    counts: tuple[int, int]
    degrees: float = 0.0
    """Rotation of every place about its datum, counter-clockwise."""
    mirrored: bool = False
    """Whether the step lies upside down: mirrored in x about its datum, before the rotation."""


@dataclass(frozen=True)
class Step:
    """One step of a file: a board, or a panel with what it repeats."""

    design: Design
    datum: XY = (0.0, 0.0)
    repeats: tuple[Repeat, ...] = ()


@dataclass
class _Layout:
    """The boards of a panel as they are found."""

    where: str
    read: Callable[[str], Step]
    boards: list[PlacedBoard] = field(default_factory=list)
    """Boards, and the panels within the panel that have marks or parts."""
    steps: Counter[str] = field(default_factory=Counter)
    """Number of boards of each step."""
    bare: Counter[str] = field(default_factory=Counter)
    """Number of places of each step without components."""
    known: dict[str, Step] = field(default_factory=dict)

    def step(self, name: str) -> Step:
        """Return a step, which is read once."""
        if name not in self.known:
            self.known[name] = self.read(name)
        return self.known[name]

    def add(self, repeats: Sequence[Repeat], at: Placement, above: tuple[str, ...]) -> None:
        """Add the boards that the repeats of one step place; `above` are the steps that contain it."""
        for repeat in repeats:
            if repeat.step in above:
                raise InputError(f"{self.where}: steps contain one another: {' > '.join((*above, repeat.step))}.")
            if len(above) >= MOST_LEVELS:
                raise InputError.field(
                    self.where, "the depth of its steps", ">".join((*above, repeat.step)), f"at most {MOST_LEVELS}"
                )
            step = self.step(repeat.step)
            for place in _places(repeat, step.datum, self.where):
                self._add_one(repeat.step, step, place.within(at), above)

    def _add_one(self, name: str, step: Step, at: Placement, above: tuple[str, ...]) -> None:
        if step.repeats:
            if step.design.parts or step.design.marks:
                within = sum(board.position is None for board in self.boards)
                self._append(PlacedBoard(f"{name}-{within + 1}", None, step.design, at))
            self.add(step.repeats, at, (*above, name))
        elif step.design.parts:
            self.steps[name] += 1
            position = str(self.steps.total())
            self._append(PlacedBoard(position, position, step.design, at))
        else:
            self.bare[name] += 1
            self._count()

    def _append(self, board: PlacedBoard) -> None:
        self.boards.append(board)
        self._count()

    def _count(self) -> None:
        count = len(self.boards) + self.bare.total()
        if count > MOST_BOARDS:
            raise InputError.field(self.where, "the number of boards of the panel", f"{count} or more", _UP_TO)


_UP_TO = f"at most {MOST_BOARDS}"


def _places(repeat: Repeat, datum: XY, where: str) -> Iterator[Placement]:
    """Yield the placements of a block, along x first."""
    nx, ny = repeat.counts
    key = f"the number of places of step {repeat.step!r}"
    if nx * ny > MOST_BOARDS:
        raise InputError.field(where, key, f"{nx} × {ny}", _UP_TO)
    if min(nx, ny) < 1:
        raise InputError.field(where, key, f"{nx} × {ny}", "at least 1 × 1")
    for n, pitch, axis in zip(repeat.counts, repeat.pitch, "xy", strict=True):
        if n > 1 and abs(pitch) < 1e-3:
            raise InputError.field(
                where, f"the pitch of step {repeat.step!r} along {axis}", pitch, f"above 0 for {n} places"
            )
    about = Placement(repeat.mirrored, repeat.degrees, (0.0, 0.0)).apply(datum)
    for iy in range(ny):
        for ix in range(nx):
            x = repeat.first[0] + ix * repeat.pitch[0] - about[0]
            y = repeat.first[1] + iy * repeat.pitch[1] - about[1]
            yield Placement(repeat.mirrored, repeat.degrees, (x, y))


def panel_of(name: str, read: Callable[[str], Step], where: str) -> Design:
    """Return the design of a step with all boards that it repeats, at any depth; of a step without repeats the step's.

    Args:
        name: the step.
        read: returns a step by its name.
        where: the file, for messages.

    Raises:
        InputError: no board is repeated, steps contain one another, or a limit is exceeded.
    """
    layout = _Layout(where, read)
    top = layout.step(name)
    if not top.repeats:
        return top.design
    layout.add(top.repeats, Placement(False, 0.0, (0.0, 0.0)), (name,))
    if not layout.steps:
        raise InputError(
            f"{where}: step {name!r} repeats no step with components ({', '.join(sorted(layout.bare))}).",
            action="Choose the step of the board by --step.",
        )
    shown = ", ".join(f"{count} of step {step}" for step, count in layout.steps.items())
    notes = [f"step {name} is a panel of {layout.steps.total()} boards: {shown}; their positions count from 1."]
    if over := [board.name for board in layout.boards if board.position and board.at.mirrored]:
        notes.append(f"{len(over)} boards lie upside down, so that their other side is up: positions {_some(over)}.")
    if layout.bare:
        notes.append(f"repeated steps without components were left out: {', '.join(sorted(layout.bare))}.")
    return replace(top.design, boards=tuple(layout.boards), notes=(*top.design.notes, *notes))


def note_on_panels(names: Sequence[str]) -> list[str]:
    """Return the sentence that names the panels of a file of which a board was read; none without panels."""
    if not names:
        return []
    return [f"steps that repeat boards: {_some(names)}. If panels run through the line, choose the panel by --step."]


@dataclass(frozen=True)
class Grid:
    """How a person says that a board is repeated on its panel; lengths in mm."""

    counts: tuple[int, int]
    """Number of boards along x and along y."""
    pitch: XY
    degrees: tuple[float, ...] = (0.0,)
    """Rotations of the boards about their middle, in the order of the positions; they start again behind the last."""
    border: XY | None = None
    """Distance of the panel's edges from the outermost boards; None: not known, so that the panel has no outline."""

    @classmethod
    def parse(cls, repeat: str | None, pitch: str | None, rotate: str | None, border: str | None) -> Grid | None:
        """Return the grid from texts such as `3x2`, `30x28.5`, `0,180` and `0x5`; None without any.

        Raises:
            InputError: a text cannot be understood, or one of the first two is missing.
        """
        others = {"--pitch": pitch, "--rotate": rotate, "--border": border}
        if not repeat:
            for key, value in others.items():
                if value:
                    raise InputError.field(key, "the value", value, "given together with --repeat")
            return None
        counts = _pair("--repeat", repeat, "two whole numbers such as 3x2, along x and y")
        if min(counts) < 1 or any(c % 1 for c in counts) or counts[0] * counts[1] > MOST_BOARDS:
            raise InputError.field("--repeat", "the value", repeat, f"whole numbers from 1, {_UP_TO} boards together")
        apart = _pair("--pitch", pitch, "two lengths in mm such as 30x28.5, from board to board along x and y")
        for n, length, axis in zip(counts, apart, "xy", strict=True):
            if n > 1 and abs(length) < 1.0:
                raise InputError.field("--pitch", f"the length along {axis}", length, "1 mm at least")
        edge = None if not border else _pair("--border", border, "two lengths in mm such as 0x5, along x and y")
        if edge is not None and min(edge) < 0:
            raise InputError.field("--border", "the value", border, "0 mm at least")
        return cls((int(counts[0]), int(counts[1])), apart, _degrees(rotate), edge)


def _pair(key: str, text: str | None, limit: str) -> XY:
    found = re.fullmatch(r"\s*([-+]?[\d.]+)\s*[x×,]\s*([-+]?[\d.]+)\s*", text or "")
    try:
        x, y = (float(word) for word in found.groups()) if found else (math.nan, math.nan)
    except ValueError:
        x = y = math.nan
    if not max(abs(x), abs(y)) <= MOST_MM:
        raise InputError.field(key, "the value", text, limit)
    return x, y


def _degrees(text: str | None) -> tuple[float, ...]:
    try:
        found = tuple(float(word) for word in text.split(",")) if text else (0.0,)
    except ValueError:
        found = (math.nan,)
    if len(found) > MOST_BOARDS or not all(abs(angle) <= 360 for angle in found):
        raise InputError.field("--rotate", "the value", text, "angles in degrees such as 180, or 0,180 in turn")
    return found


def repeated(design: Design, grid: Grid) -> Design:
    """Return a panel that has the board of a design at the places of a grid; the first stays where the design has it.

    Raises:
        InputError: the design is a panel, or has no outline although the border of the panel is stated.
    """
    if design.boards:
        raise InputError(f"{design.name!r} is a panel of {len(design.boards)} boards; --repeat is for one board.")
    corners = design.outline or [part.center for part in design.parts]
    if grid.border is not None and not design.outline:
        raise InputError(
            f"{design.name!r} has no outline, so that --border does not state where the panel ends.",
            action="Leave --border out, or join a file that has the outline.",
        )
    if not corners:
        return design
    low, high = _extent(corners)
    middle = (low[0] + high[0]) / 2, (low[1] + high[1]) / 2
    bare = replace(design, notes=(), table=None)
    boards, edges = [], []
    for n in range(grid.counts[0] * grid.counts[1]):
        ix, iy = n % grid.counts[0], n // grid.counts[0]
        turn = grid.degrees[n % len(grid.degrees)]
        (x, y) = Placement(False, turn, (0.0, 0.0)).apply(middle)
        at = Placement(False, turn, (middle[0] + ix * grid.pitch[0] - x, middle[1] + iy * grid.pitch[1] - y))
        boards.append(PlacedBoard(str(n + 1), str(n + 1), bare, at))
        edges.append(_extent([at.apply(corner) for corner in corners]))
    nx, ny = grid.counts
    notes = [f"the board is repeated {nx} × {ny} times; positions count from 1, along x first."]
    sizes = [max(far[k] - near[k] for near, far in edges) for k in (0, 1)]
    for size, pitch, n, axis in zip(sizes, grid.pitch, grid.counts, "xy", strict=True):
        if n > 1 and abs(pitch) < size - 1e-3:
            notes.append(f"the pitch along {axis} is {abs(pitch):g} mm, but the board measures {size:.3f} mm there.")
    outline: tuple[XY, ...] = ()
    if grid.border is None:
        notes.append("the edges of the panel are not known, so that it has no outline; state them by --border.")
    else:
        (x0, y0), (x1, y1) = _extent([corner for edge in edges for corner in edge])
        (bx, by) = grid.border
        outline = ((x0 - bx, y0 - by), (x1 + bx, y0 - by), (x1 + bx, y1 + by), (x0 - bx, y1 + by))
    panel = replace(design, parts=(), outline=outline, cut_outs=(), marks=(), boards=tuple(boards))
    return panel.with_notes(*notes)


def _extent(points: Iterable[XY]) -> tuple[XY, XY]:
    xs, ys = zip(*points, strict=True)
    return (min(xs), min(ys)), (max(xs), max(ys))


def laid_out(design: Design) -> Design:
    """Return a panel with the parts and marks of its boards; a design without boards as it is.

    The marks of both sides are found before, on each design by itself, so that they are final. Fiducials of the panel
    itself place the panel. A bad-board mark of the panel belongs to the board within whose outline it lies.

    Raises:
        InputError: the panel has too many parts.
    """
    if not design.boards:
        return design
    count = len(design.parts) + sum(len(board.design.parts) for board in design.boards)
    if count > MOST_PARTS:
        raise InputError.field(design.name, "the number of parts of the panel", count, f"at most {MOST_PARTS}")
    parts = list(design.parts)
    marks = [_of_board_below(_of_panel(mark), design.boards) for mark in _all_marks(design)]
    found: dict[int, tuple[list[Mark], list[_Sized]]] = {}
    contours: list[tuple[float, Placement, tuple[XY, ...]]] = []
    for board in design.boards:
        parts += [_placed_part(part, board) for part in board.design.parts]
        key = id(board.design)
        if key not in found:
            found[key] = _all_marks(board.design), _largest_cut_outs(board.design)
        marks += [_placed_mark(mark, board) for mark in found[key][0]]
        contours += ((size, board.at, contour) for size, contour in found[key][1])
    kept = nlargest(MOST_CUT_OUTS, contours, key=lambda c: c[0])
    cut_outs = (*design.cut_outs, *(tuple(map(at.apply, contour)) for _, at, contour in kept))
    left_out = sum(len(board.design.cut_outs) for board in design.boards) - len(kept)
    notes = (f"{left_out} contours of the boards are too many or too fine; they were left out.",) if left_out else ()
    laid = replace(design, parts=tuple(parts), marks=tuple(marks), cut_outs=cut_outs)
    return laid.with_notes(*notes)


_Sized = tuple[float, tuple[XY, ...]]
"""Area and corners of a contour."""


def _largest_cut_outs(design: Design) -> list[_Sized]:
    usable = ((abs(area(c)), c) for c in design.cut_outs if len(c) <= MOST_OUTLINE_POINTS)
    return nlargest(MOST_CUT_OUTS, usable, key=lambda c: c[0])


def _all_marks(design: Design) -> list[Mark]:
    """Return the marks of both sides of one design; those on both sides twice."""
    bare = replace(design, boards=())
    sides: tuple[Side, ...] = get_args(Side)
    return [
        replace(mark, side=side)
        for side in sides
        for mark in find_marks(bare, [part for part in design.parts if part.side == side], side)
    ]


def _of_panel(mark: Mark) -> Mark:
    """Return a mark of the panel itself; the panel's fiducials place it, unless they lie outside its outline."""
    return replace(mark, kind="global") if mark.kind == "panel" and mark.found_by != "place" else mark


def _of_board_below(mark: Mark, boards: Sequence[PlacedBoard]) -> Mark:
    """Return a mark of the panel; a bad-board mark with the position of the board on which it lies."""
    if mark.kind != "bad-board":
        return mark
    below = [b.position for b in boards if b.position and _lies_on(b.at.undo(mark.at), b.design.outline)]
    return replace(mark, panel=below[0]) if len(below) == 1 else mark


def _lies_on(point: XY, outline: Sequence[XY]) -> bool:
    if len(outline) < 3:
        return False
    xs, ys = zip(*outline, strict=True)
    return min(xs) <= point[0] <= max(xs) and min(ys) <= point[1] <= max(ys) and bool(encloses(outline, point))


def _placed_part(part: Part, board: PlacedBoard) -> Part:
    at, side, rotation, box = board.at, part.side, part.rotation, part.box
    if at.mirrored:
        side, rotation, box = _other(side), -rotation, box.mirrored() if box else None
    return replace(
        part,
        ref=part.ref if board.position else f"{board.name}/{part.ref}",
        side=side,
        origin=at.apply(part.origin),
        rotation=normalised(rotation + at.degrees),
        box=box,
        panel=board.position,
    )


def _placed_mark(mark: Mark, board: PlacedBoard) -> Mark:
    at, side = board.at, mark.side
    if at.mirrored and side is not None:
        side = _other(side)
    placed = replace(
        mark,
        name=f"{board.name}/{mark.name}",
        side=side,
        at=at.apply(mark.at),
        components=tuple(f"{board.name}/{ref}" for ref in mark.components),
    )
    return _of_panel(placed) if board.position is None else replace(placed, panel=board.position)


def _other(side: Side) -> Side:
    return "bottom" if side == "top" else "top"


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
