"""A board that is repeated on a panel of which its file has no data, as a person states it."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from vaoi_station.board_data.design import XY, Contour, Design, PlacedBoard, Placement, extent, noted
from vaoi_station.board_data.panels.step_and_repeat import MOST_BOARDS
from vaoi_station.board_data.source_text import number_of
from vaoi_station.errors import InputError
from vaoi_station.model.frozen_model import MOST_MM


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
        if not repeat:
            for key, value in {"--pitch": pitch, "--rotate": rotate, "--border": border}.items():
                if value:
                    raise InputError.field(key, "the value", value, "given together with --repeat")
            return None
        nx, ny = _pair("--repeat", repeat, "two whole numbers such as 3x2, along x and y")
        if min(nx, ny) < 1 or nx % 1 or ny % 1 or nx * ny > MOST_BOARDS:
            limit = f"whole numbers from 1, at most {MOST_BOARDS} boards together"
            raise InputError.field("--repeat", "the value", repeat, limit)
        lengths = "two lengths in mm such as 30x28.5, from board to board along x and y"
        if not pitch:
            raise InputError(f"--repeat {repeat} needs --pitch, {lengths}.")
        apart = _pair("--pitch", pitch, lengths)
        for n, length, axis in zip((nx, ny), apart, "xy", strict=True):
            if n > 1 and abs(length) < 1.0:
                raise InputError.field("--pitch", f"the length along {axis}", length, "1 mm at least")
        edge = None if not border else _pair("--border", border, "two lengths in mm such as 0x5, along x and y")
        if edge is not None and min(edge) < 0:
            raise InputError.field("--border", "the value", border, "0 mm at least")
        degrees = [number_of(word) for word in rotate.split(",")] if rotate else [0.0]
        usable = tuple(angle for angle in degrees if angle is not None and abs(angle) <= 360)
        if len(usable) < len(degrees) or len(degrees) > MOST_BOARDS:
            raise InputError.field("--rotate", "the value", rotate, "angles in degrees such as 180, or 0,180 in turn")
        return cls((int(nx), int(ny)), apart, usable, edge)


def _pair(key: str, text: str, limit: str) -> XY:
    found = re.fullmatch(r"\s*([-+]?[\d.]+)\s*[x×,]\s*([-+]?[\d.]+)\s*", text)
    x, y = (number_of(word) for word in found.groups()) if found else (None, None)
    if x is None or y is None or max(abs(x), abs(y)) > MOST_MM:
        raise InputError.field(key, "the value", text, limit)
    return x, y


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
    nx, ny = grid.counts
    for n in range(nx * ny):
        turn = grid.degrees[n % len(grid.degrees)]
        (x, y) = Placement(False, turn).apply(middle)
        shift = middle[0] + n % nx * grid.pitch[0] - x, middle[1] + n // nx * grid.pitch[1] - y
        boards.append(PlacedBoard(str(n + 1), str(n + 1), bare, at := Placement(False, turn, shift)))
        edges.append(extent([at.apply(corner) for corner in corners]))
    text = "the board is repeated {counts} times; positions count from 1, along x first."
    notes = [noted("board-repeated", text, counts=f"{nx} × {ny}")]
    for k, (n, pitch, axis) in enumerate(zip(grid.counts, grid.pitch, "xy", strict=True)):
        size = max(far[k] - near[k] for near, far in edges)
        if n > 1 and abs(pitch) < size - 1e-3:
            text = "the pitch along {axis} is {pitch_mm} mm, but the board measures {size_mm} mm there."
            notes.append(noted("pitch-below-size", text, axis=axis, pitch_mm=f"{abs(pitch):g}", size_mm=f"{size:.3f}"))
    outline: Contour = ()
    if grid.border is not None:
        (x0, y0), (x1, y1) = extent([corner for edge in edges for corner in edge])
        bx, by = grid.border
        outline = ((x0 - bx, y0 - by), (x1 + bx, y0 - by), (x1 + bx, y1 + by), (x0 - bx, y1 + by))
    elif design.outline:
        text = (
            "the edges of the panel are not known, so that it has no outline and the extent of parts and fiducials is "
            "used; state them by --border."
        )
        notes.append(noted("panel-edges-unknown", text))
    panel = replace(design, parts=(), outline=outline, cut_outs=(), marks=(), net_points=(), boards=tuple(boards))
    return panel.with_notes(*notes)
