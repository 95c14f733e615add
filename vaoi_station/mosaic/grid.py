"""The pixel grid of a mosaic, its transform from CAD coordinates, and its levels and tiles as viewers ask for them.

The mosaic shows a region of the board as temporary images do: upright, never mirrored, CAD "up" points up. The edges of
the region are the outer edges of the border pixels, so the centre of pixel (0, 0) lies half a pixel inside the region.
Level k is the mosaic reduced by 2ᵏ. Deep Zoom (DZI) counts from the other end: its level 0 has one pixel.
"""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.frame_index import Box
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType

MOST_PIXELS = 1_000_000_000
"""Largest number of pixels of a mosaic: a board of 400 × 410 mm at 78 px/mm."""
MARGIN_MM = 5.0
"""How far a region may extend beyond the board."""
RESOLUTION_LIMITS = (0.1, 1000.0)
"""Smallest and largest resolution that a caller may request, px/mm."""

Region = tuple[float, float, float, float]
"""Two opposite corners x0, y0, x1, y1 in CAD coordinates."""


@dataclass(frozen=True, eq=False)
class MosaicGrid:
    """Size of a mosaic and its transform from CAD coordinates: scale and shift only."""

    width: int
    height: int
    px_per_mm: float
    mosaic_from_cad: Floats
    """(3, 3) matrix from CAD coordinates to pixels."""
    cad_from_mosaic: Floats
    """(3, 3) inverse matrix."""

    @classmethod
    def of_board(
        cls,
        board_type: BoardType,
        px_per_mm: float,
        region: Sequence[float] | None = None,
        most_px: float = MOST_PIXELS,
    ) -> MosaicGrid:
        """Return the grid of a region of a board (two opposite corners in CAD coordinates), or of the whole board.

        Raises:
            InputError: the region has no area or lies off the board, or the mosaic would be too large.
        """
        low_limit, high_limit = RESOLUTION_LIMITS
        if not low_limit <= px_per_mm <= high_limit:
            raise InputError.field("mosaic", "px_per_mm", px_per_mm, f"a number from {low_limit:g} to {high_limit:g}")
        low, high = board_type.extent() if region is None else _corners(board_type, region)
        mm = (high - low) * board_type.mm_per_unit
        size = np.maximum(np.round(mm * px_per_mm), 1)
        if size[0] * size[1] > most_px:
            raise InputError.field(
                "mosaic",
                "px_per_mm",
                px_per_mm,
                f"small enough for {most_px / 1e6:.0f} megapixels (this would be {size[0]:.0f}×{size[1]:.0f})",
                "Give a lower resolution or a smaller region.",
            )
        # The board as the camera sees it, never mirrored (docs/conventions.md): on the bottom side CAD x runs left.
        way = np.array([1.0 if board_type.side == "top" else -1.0, 1.0 if board_type.y_axis == "down" else -1.0])
        scale = way * size / (high - low)
        origin = np.where(way > 0, low, high)
        matrix = np.diag([*scale, 1.0])
        matrix[:2, 2] = -scale * origin - 0.5
        back = np.asarray(np.linalg.inv(matrix), np.float64)
        return cls(int(size[0]), int(size[1]), float(px_per_mm), matrix, back)

    @property
    def place(self) -> tuple[Floats, tuple[int, int]]:
        """The transform from CAD coordinates, and the size: what the index of frames asks for."""
        return self.mosaic_from_cad, (self.width, self.height)

    def reduced(self, factor: int) -> MosaicGrid:
        """Return the grid of the same region with pixels that are `factor` times as large; the last ones may overlap
        the region's end."""
        shrink = np.diag([1 / factor, 1 / factor, 1.0])
        shrink[:2, 2] = 0.5 / factor - 0.5
        matrix = np.asarray(shrink @ self.mosaic_from_cad, np.float64)
        width, height = -(-self.width // factor), -(-self.height // factor)
        back = np.asarray(np.linalg.inv(matrix), np.float64)
        return MosaicGrid(width, height, self.px_per_mm / factor, matrix, back)


def _corners(board_type: BoardType, region: Sequence[float]) -> tuple[Floats, Floats]:
    """Return the lowest and the highest corner of a region; refuse one without area or off the board."""
    given = np.asarray(region, dtype=np.float64).reshape(2, 2)
    low, high = given.min(0), given.max(0)
    least, most = board_type.extent()
    margin = MARGIN_MM / board_type.mm_per_unit
    text = ", ".join(f"{v:g}" for v in given.ravel())
    if not np.isfinite(given).all() or (high <= low).any():
        raise InputError.field("mosaic", "region", text, "two opposite corners x0, y0, x1, y1 of an area")
    if (low < least - margin).any() or (high > most + margin).any():
        board = f"({least[0]:g}, {least[1]:g}) to ({most[0]:g}, {most[1]:g}) {board_type.unit}"
        raise InputError.field(
            "mosaic", "region", text, f"on the board, {board}, or at most {MARGIN_MM:g} mm beside it"
        )
    return low, high


TILE_PX = 256
_DZI = "http://schemas.microsoft.com/deepzoom/2008"


def levels_of(grid: MosaicGrid) -> int:
    """Return the number of reductions for which a mosaic has tiles: until the smallest fits into one tile."""
    return 1 + max(math.ceil(math.log2(max(grid.width, grid.height) / TILE_PX)), 0)


def dzi_document(grid: MosaicGrid, suffix: str) -> str:
    """Return the .dzi file of a mosaic whose tiles have this suffix."""
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<Image xmlns="{_DZI}" Format="{html.escape(suffix)}" Overlap="0" TileSize="{TILE_PX}">'
        f'<Size Width="{grid.width}" Height="{grid.height}"/></Image>\n'
    )


def dzi_reduction(grid: MosaicGrid, level: int) -> int:
    """Return the factor by which a level of DZI is reduced. Raise NotFoundError if there is no such level."""
    last = math.ceil(math.log2(max(grid.width, grid.height)))
    if not 0 <= level <= last:
        raise NotFoundError(
            f"the mosaic has the levels 0 to {last}; there is no level {level}.",
            action="Take levels from the .dzi file.",
            code="no-such-tile",
        )
    return int(2 ** (last - level))


def tile_box(grid: MosaicGrid, column: int, row: int) -> Box:
    """Return the part of a reduced mosaic that a tile shows. Raise NotFoundError if there is no such tile."""
    columns, rows = -(-grid.width // TILE_PX), -(-grid.height // TILE_PX)
    if not (0 <= column < columns and 0 <= row < rows):
        raise NotFoundError(
            f"this level has {columns}×{rows} tiles, counted from 0; there is no tile {column}_{row}.",
            action="Take tiles of the level's size.",
            code="no-such-tile",
        )
    x, y = column * TILE_PX, row * TILE_PX
    return x, y, min(x + TILE_PX, grid.width), min(y + TILE_PX, grid.height)
