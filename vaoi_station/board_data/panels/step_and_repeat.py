"""Step-and-repeat of a file: steps that place other steps in grids, down to the boards.

The boards of a panel have the positions "1", "2", … in the order of the blocks; in a block along x first, then along y.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

from vaoi_station.board_data.design import XY, Design, PlacedBoard, Placement
from vaoi_station.errors import InputError
from vaoi_station.model.reason import Note

MOST_BOARDS = 1_000
"""A panel of 250 × 330 mm has 1,000 boards if each is 9 mm square."""
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
    datum: Callable[[], XY] = lambda: (0.0, 0.0)
    """Returns the datum. It is read only when a panel places the step: no board alone needs it."""
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
            for place in _places(repeat, step.datum(), self.where):
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
    count = layout.steps.total()
    sentence = f"step {name} is a panel of {count} boards: {shown}; their positions count from 1."
    notes = [Note("step-is-panel", sentence, step=name, count=count)]
    if over := [board.name for board in layout.boards if board.position and board.at.mirrored]:
        names = _some(over)
        sentence = f"{len(over)} boards lie upside down, so that their other side is up: positions {names}."
        notes.append(Note("boards-upside-down", sentence, count=len(over), names=names))
    # By 0° and 180° both orders of mirroring and turning are the same.
    turned = [board.name for board in layout.boards if board.at.mirrored and board.at.degrees % 180]
    if turned:
        names = _some(turned)
        sentence = (
            "boards lie upside down and turned, for which programs differ in what they do first: check in the picture "
            f"that the boards lie within the panel: {names}."
        )
        notes.append(Note("boards-turned-over", sentence, names=names))
    if layout.bare:
        names = ", ".join(sorted(layout.bare))
        notes.append(Note("bare-steps", f"repeated steps without components were left out: {names}.", names=names))
    notes += [
        Note(note.code, f"step {used}: {note}", **note.values)
        for used, step in layout.known.items()
        if used != name
        for note in step.design.notes
    ]
    return replace(top.design, boards=tuple(layout.boards), notes=(*top.design.notes, *notes))


def note_on_panels(names: Sequence[str]) -> list[Note]:
    """Return the note that names the panels of a file of which a board was read; none without panels."""
    if not names:
        return []
    shown = _some(names)
    sentence = f"steps that repeat boards: {shown}. If panels run through the line, choose the panel by --step."
    return [Note("panels-in-file", sentence, names=shown)]


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
