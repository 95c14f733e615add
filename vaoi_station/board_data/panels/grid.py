"""A board that is repeated on a panel of which its file has no data, as a person states it."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

from vaoi_station.board_data.design import XY, Design, PlacedBoard, Placement, extent
from vaoi_station.board_data.panels.step_and_repeat import MOST_BOARDS
from vaoi_station.errors import InputError
from vaoi_station.model.frozen_model import MOST_MM
from vaoi_station.model.reason import Note

_UP_TO = f"at most {MOST_BOARDS}"


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
        lengths = "two lengths in mm such as 30x28.5, from board to board along x and y"
        if not pitch:
            raise InputError(f"--repeat {repeat} needs --pitch, {lengths}.")
        apart = _pair("--pitch", pitch, lengths)
        for n, length, axis in zip(counts, apart, "xy", strict=True):
            if n > 1 and abs(length) < 1.0:
                raise InputError.field("--pitch", f"the length along {axis}", length, "1 mm at least")
        edge = None if not border else _pair("--border", border, "two lengths in mm such as 0x5, along x and y")
        if edge is not None and min(edge) < 0:
            raise InputError.field("--border", "the value", border, "0 mm at least")
        return cls((int(counts[0]), int(counts[1])), apart, _degrees(rotate), edge)


def _pair(key: str, text: str, limit: str) -> XY:
    found = re.fullmatch(r"\s*([-+]?[\d.]+)\s*[x×,]\s*([-+]?[\d.]+)\s*", text)
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
    low, high = extent(corners)
    middle = (low[0] + high[0]) / 2, (low[1] + high[1]) / 2
    bare = replace(design, notes=(), table=None)
    boards, edges = [], []
    for n in range(grid.counts[0] * grid.counts[1]):
        ix, iy = n % grid.counts[0], n // grid.counts[0]
        turn = grid.degrees[n % len(grid.degrees)]
        (x, y) = Placement(False, turn, (0.0, 0.0)).apply(middle)
        at = Placement(False, turn, (middle[0] + ix * grid.pitch[0] - x, middle[1] + iy * grid.pitch[1] - y))
        boards.append(PlacedBoard(str(n + 1), str(n + 1), bare, at))
        edges.append(extent([at.apply(corner) for corner in corners]))
    nx, ny = grid.counts
    sentence = f"the board is repeated {nx} × {ny} times; positions count from 1, along x first."
    notes = [Note("board-repeated", sentence, counts=f"{nx} × {ny}")]
    sizes = [max(far[k] - near[k] for near, far in edges) for k in (0, 1)]
    for size, pitch, n, axis in zip(sizes, grid.pitch, grid.counts, "xy", strict=True):
        if n > 1 and abs(pitch) < size - 1e-3:
            stated, there = f"{abs(pitch):g}", f"{size:.3f}"
            sentence = f"the pitch along {axis} is {stated} mm, but the board measures {there} mm there."
            notes.append(Note("pitch-below-size", sentence, axis=axis, pitch_mm=stated, size_mm=there))
    outline: tuple[XY, ...] = ()
    if grid.border is None and design.outline:
        sentence = (
            "the edges of the panel are not known, so that it has no outline and the extent of parts and fiducials is "
            "used; state them by --border."
        )
        notes.append(Note("panel-edges-unknown", sentence))
    elif grid.border is not None:
        (x0, y0), (x1, y1) = extent([corner for edge in edges for corner in edge])
        (bx, by) = grid.border
        outline = ((x0 - bx, y0 - by), (x1 + bx, y0 - by), (x1 + bx, y1 + by), (x0 - bx, y1 + by))
    panel = replace(design, parts=(), outline=outline, cut_outs=(), marks=(), boards=tuple(boards))
    return panel.with_notes(*notes)
