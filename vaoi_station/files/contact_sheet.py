"""The contact sheet of a run: one image with labelled pictures of many components, and the verdict above them.

The pictures lie in a grid. Large components get several cells, so that a connector and a resistor are both legible. The
sheet is meant for people, not for measurements: grey levels and sizes differ from those of the frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.model import Status

Canvas = NDArray[np.uint8]

COLUMNS = 16
CELL_PX, GAP_PX, MARGIN_PX = 72, 8, 24
LABEL_PX = 18
HEADER_PX = 92
MOST_CELLS = 3
"""Largest number of cells that a picture takes along each axis."""
SIDE_PER_CELL_PX = 130
"""Side of a picture in px that fits into one cell. A side up to n² times as long gets n cells, at most `MOST_CELLS`."""
MAGNIFIED = 2.0
"""Largest factor by which small pictures are enlarged."""
GREY_STEP = 4
"""Step between grey levels. 64 levels are enough for the eye and halve the file; finer levels are mostly noise."""

_PAPER, _CARD, _INK, _FAINT = (255, 255, 255), (243, 241, 239), (38, 32, 28), (116, 106, 98)
_COLOURS = {Status.OK: (82, 130, 28), Status.DEGRADED: (0, 118, 196), Status.FAILED: (38, 38, 190)}
"""Colour of each verdict; all colours are in the channel order of OpenCV: blue, green, red."""
_NAME, _NOTE = (12, 700), (11, 400)
"""Font size and font weight of a tile's title, and of its note."""


@dataclass(frozen=True, eq=False)
class Tile:
    """One component on the sheet: its picture and its label."""

    picture: NDArray[Any] | None
    """(h, w) or (h, w, 3) pixels, 8 or 16 bit; None if no frame shows the component."""
    title: str
    """Main text of the label: the component's name or the frame of the picture."""
    note: str = ""
    """Fainter text beside the title, such as the frame or the coverage."""

    @property
    def span(self) -> tuple[int, int]:
        """The number of cells that the tile occupies along x and y."""
        if self.picture is None:
            return 1, 1
        sides = self.picture.shape[1::-1]
        columns, rows = (min(max(math.ceil(math.sqrt(s / SIDE_PER_CELL_PX)), 1), MOST_CELLS) for s in sides)
        width, height = _fitted_size(sides, _box(columns, rows))
        # A long, thin picture does not fill its block of cells. The tile takes only the cells that the picture covers.
        return min(columns, -(-(width + GAP_PX) // _step(0))), min(rows, -(-(height + GAP_PX + LABEL_PX) // _step(1)))


def contact_sheet(tiles: Sequence[Tile], title: str, status: Status, facts: Sequence[str]) -> Canvas:
    """Draw the contact sheet, (h, w, 3) in blue, green, red, of a fixed width; `facts` are drawn below the title."""
    # Large tiles are placed first; small tiles then fill the gaps between them.
    order = sorted(tiles, key=lambda t: -t.span[0] * t.span[1])
    places = _places([t.span for t in order])
    rows = max((y + t.span[1] for (_, y), t in zip(places, order, strict=True)), default=0)
    size = (HEADER_PX + rows * _step(1) + MARGIN_PX - GAP_PX, 2 * MARGIN_PX + COLUMNS * _step(0) - GAP_PX, 3)
    sheet = np.full(size, _PAPER, np.uint8)
    _draw_header(sheet, title, status, facts)
    for (x, y), tile in zip(places, order, strict=True):
        _draw_tile(sheet, tile, MARGIN_PX + x * _step(0), HEADER_PX + y * _step(1))
    return sheet


def _step(axis: int) -> int:
    """Return the distance in px between neighbouring cells, along x (axis 0) or y (axis 1)."""
    return CELL_PX + GAP_PX + (LABEL_PX if axis else 0)


def _places(spans: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """Choose a place for each tile: the highest column and row at which all cells of the tile are free."""
    taken: set[tuple[int, int]] = set()
    places = []
    for columns, rows in spans:
        y = 0
        while True:
            fits = (
                x
                for x in range(COLUMNS - columns + 1)
                if not any((x + dx, y + dy) in taken for dx in range(columns) for dy in range(rows))
            )
            if (x := next(fits, None)) is not None:
                break
            y += 1
        places.append((x, y))
        taken |= {(x + dx, y + dy) for dx in range(columns) for dy in range(rows)}
    return places


def _draw_header(sheet: Canvas, title: str, status: Status, facts: Sequence[str]) -> None:
    right = _write(sheet, title, MARGIN_PX, 44, 26, 700, _INK)
    word = str(status).upper()
    left, width = right + 16, _width(word, 16, 700) + 24
    _pill(sheet, left, 24, width, 26, _COLOURS[status])
    _write(sheet, word, left + 12, 43, 16, 700, _PAPER)
    # The facts get the largest size at which they fit into one line.
    line, room = "   ·   ".join(facts), sheet.shape[1] - 2 * MARGIN_PX
    size = next((s for s in range(15, 9, -1) if _width(line, s, 400) <= room), 9)
    _write(sheet, line, MARGIN_PX, 73, size, 400, _FAINT)


def _draw_tile(sheet: Canvas, tile: Tile, x: int, y: int) -> None:
    """Draw a tile at pixel (x, y) of the sheet: the picture, and the label below it."""
    width, height = _box(*tile.span)
    sheet[y : y + height, x : x + width] = _CARD
    if tile.picture is not None:
        picture = _fitted(tile.picture, (width, height))
        h, w = picture.shape[:2]
        top, left = y + (height - h) // 2, x + (width - w) // 2
        sheet[top : top + h, left : left + w] = picture
    room = width - (_width(tile.note, *_NOTE) + 5 if tile.note else 0)
    right = _write(sheet, _shortened(tile.title, room), x, y + height + 13, *_NAME, _INK)
    _write(sheet, tile.note, right + 5, y + height + 13, *_NOTE, _FAINT)


def _fitted(picture: NDArray[Any], box: tuple[int, int]) -> Canvas:
    """Scale a picture to fit into a box (width, height), and convert it to three channels with 64 grey levels."""
    eight = picture if picture.dtype == np.uint8 else np.asarray(picture >> 8, np.uint8)
    size = _fitted_size(eight.shape[1::-1], box)
    # INTER_AREA averages pixels, which avoids aliasing when a picture shrinks. An enlarged picture would show blocks.
    scaled = cv2.resize(eight, size, interpolation=cv2.INTER_AREA if size[0] < eight.shape[1] else cv2.INTER_LINEAR)
    even = np.asarray(scaled // GREY_STEP * GREY_STEP + GREY_STEP // 2, np.uint8)
    return np.asarray(even if even.ndim == 3 else cv2.cvtColor(even, cv2.COLOR_GRAY2BGR), np.uint8)


def _fitted_size(sides: Sequence[int], box: tuple[int, int]) -> tuple[int, int]:
    """Return the width and height of a picture after it is scaled to fit into a box. `sides` are those before."""
    scale = min(box[0] / sides[0], box[1] / sides[1], MAGNIFIED)
    return max(round(sides[0] * scale), 1), max(round(sides[1] * scale), 1)


def _box(columns: int, rows: int) -> tuple[int, int]:
    """Return the width and height, in px, of a block of cells, without the space for the label below it."""
    return columns * _step(0) - GAP_PX, rows * _step(1) - GAP_PX - LABEL_PX


def _pill(sheet: Canvas, x: int, y: int, width: int, height: int, colour: tuple[int, int, int]) -> None:
    """Draw a filled rectangle with round ends, as a thick line whose ends OpenCV rounds."""
    r = height // 2
    cv2.line(sheet, (x + r, y + r), (x + width - r, y + r), colour, height, cv2.LINE_AA)


@cache
def _font() -> Any:
    """Load the font that is part of OpenCV, so that no font needs to be installed."""
    return cv2.FontFace("sans")


def _write(
    sheet: Canvas, text: str, x: int, baseline: int, size: int, weight: int, colour: tuple[int, int, int]
) -> int:
    """Write a text on the sheet, beginning at column x. Return the column at which the text ends."""
    if text:
        cv2.putText(sheet, text, (x, baseline), colour, _font(), size, weight)
    return x + _width(text, size, weight)


def _width(text: str, size: int, weight: int) -> int:
    """Return the width of a text in px."""
    if not text:
        return 0
    x, _, width, _ = cv2.getTextSize((1, 1), text, (0, 0), _font(), size, weight)
    return int(x + width)


def _shortened(text: str, room_px: int) -> str:
    """Shorten a title with an ellipsis so that it fits into `room_px`."""
    if _width(text, *_NAME) <= room_px:
        return text
    whole = next((n for n in range(len(text) - 1, 0, -1) if _width(text[:n] + "…", *_NAME) <= room_px), 1)
    return text[:whole] + "…"
