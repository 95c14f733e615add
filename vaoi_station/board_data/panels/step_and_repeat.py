"""Step-and-repeat of a file: steps that place other steps in grids, down to the boards.

The boards of a panel have the positions "1", "2", … in the order of the blocks; in a block along x first, then along y.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from vaoi_station.board_data.design import XY, Design, PlacedBoard, Placement, noted
from vaoi_station.board_data.source_text import number_of
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

    def places(self, datum: XY, where: str) -> Iterator[Placement]:
        """Yield the placements of the block, along x first; raise InputError for an impossible grid."""
        nx, ny = self.counts
        key = f"the number of places of step {self.step!r}"
        if nx * ny > MOST_BOARDS:
            raise InputError.field(where, key, f"{nx} × {ny}", f"at most {MOST_BOARDS}")
        if min(nx, ny) < 1:
            raise InputError.field(where, key, f"{nx} × {ny}", "at least 1 × 1")
        for n, pitch, axis in zip(self.counts, self.pitch, "xy", strict=True):
            if n > 1 and abs(pitch) < 1e-3:
                key = f"the pitch of step {self.step!r} along {axis}"
                raise InputError.field(where, key, pitch, f"above 0 for {n} places")
        about = Placement(self.mirrored, self.degrees).apply(datum)
        for iy in range(ny):
            for ix in range(nx):
                x = self.first[0] + ix * self.pitch[0] - about[0]
                y = self.first[1] + iy * self.pitch[1] - about[1]
                yield Placement(self.mirrored, self.degrees, (x, y))


def stated_number(where: str, values: Mapping[str, str], key: str) -> float:
    """Return the number under a key, 0 by default; raise InputError if it is none."""
    found = number_of(text := values.get(key, "0"))
    if found is None:
        raise InputError.field(where, key, text, "a number")
    return found


def stated_count(where: str | Path, values: Mapping[str, str], key: str, shown: str = "") -> int:
    """Return the whole number under a key, 1 by default; raise InputError if it is none."""
    if not re.fullmatch(r"\d{1,9}", text := values.get(key, "1")):
        raise InputError.field(where, shown or key, text, "a whole number from 1")
    return int(text)


@dataclass(frozen=True)
class Step:
    """One step of a file: a board, or a panel with what it repeats."""

    design: Design
    datum: Callable[[], XY] = lambda: (0.0, 0.0)
    """Returns the datum. It is read only when a panel places the step: no board alone needs it."""
    repeats: tuple[Repeat, ...] = ()


class _Layout:
    """The boards of a panel as they are found."""

    def __init__(self, where: str, read: Callable[[str], Step]) -> None:
        self.where, self._read = where, read
        self.boards: list[PlacedBoard] = []
        """Boards, and the panels within the panel that have marks or parts."""
        self.steps: Counter[str] = Counter()
        """Number of boards of each step."""
        self.bare: Counter[str] = Counter()
        """Number of places of each step without components."""
        self.known: dict[str, Step] = {}

    def step(self, name: str) -> Step:
        """Return a step, which is read once."""
        if name not in self.known:
            self.known[name] = self._read(name)
        return self.known[name]

    def add(self, repeats: Sequence[Repeat], at: Placement, above: tuple[str, ...]) -> None:
        """Add the boards that the repeats of one step place; `above` are the steps that contain it."""
        for repeat in repeats:
            path = (*above, repeat.step)
            if repeat.step in above:
                raise InputError(f"{self.where}: steps contain one another: {' > '.join(path)}.")
            if len(above) >= MOST_LEVELS:
                raise InputError.field(self.where, "the depth of its steps", ">".join(path), f"at most {MOST_LEVELS}")
            step = self.step(repeat.step)
            for place in repeat.places(step.datum(), self.where):
                self._add_one(repeat.step, step, place.within(at), path)

    def _add_one(self, name: str, step: Step, at: Placement, path: tuple[str, ...]) -> None:
        if step.repeats:
            if step.design.parts or step.design.marks:
                within = sum(board.position is None for board in self.boards)
                self.boards.append(PlacedBoard(f"{name}-{within + 1}", None, step.design, at))
        elif step.design.parts:
            self.steps[name] += 1
            position = str(self.steps.total())
            self.boards.append(PlacedBoard(position, position, step.design, at))
        else:
            self.bare[name] += 1
        if (count := len(self.boards) + self.bare.total()) > MOST_BOARDS:
            limit = f"at most {MOST_BOARDS}"
            raise InputError.field(self.where, "the number of boards of the panel", f"{count} or more", limit)
        self.add(step.repeats, at, path)


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
    layout.add(top.repeats, Placement(), (name,))
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
        text = "{count} boards lie upside down, so that their other side is up: positions {names}."
        notes.append(noted("boards-upside-down", text, count=len(over), names=over))
    # By 0° and 180° both orders of mirroring and turning are the same.
    if turned := [board.name for board in layout.boards if board.at.mirrored and board.at.degrees % 180]:
        text = (
            "boards lie upside down and turned, for which programs differ in what they do first: check in the picture "
            "that the boards lie within the panel: {names}."
        )
        notes.append(noted("boards-turned-over", text, names=turned))
    if layout.bare:
        text = "repeated steps without components were left out: {names}."
        notes.append(noted("bare-steps", text, names=", ".join(sorted(layout.bare))))
    of_others = ((used, note) for used, step in layout.known.items() if used != name for note in step.design.notes)
    notes += [Note(note.code, f"step {used}: {note}", **note.values) for used, note in of_others]
    return replace(top.design, boards=tuple(layout.boards), notes=(*top.design.notes, *notes))


def note_on_panels(names: Sequence[str]) -> list[Note]:
    """Return the note that names the panels of a file of which a board was read; none without panels."""
    text = "steps that repeat boards: {names}. If panels run through the line, choose the panel by --step."
    return [noted("panels-in-file", text, names=list(names))] if names else []
