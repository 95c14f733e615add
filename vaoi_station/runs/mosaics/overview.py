"""The overview of a mosaic: its reduced levels, made once, from which tiles are cut without frames.

Each level is half as large as the one before: a pixel is the mean of those of 2 × 2 px that some frame shows.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.mosaic import MosaicGrid
from vaoi_station.mosaic.deep_zoom import TILE_PX, Box
from vaoi_station.mosaic.tiles import NODATA

BLOCK_PX = 512
"""Side of the parts in which an overview is made: at a quarter of the cameras' resolution, one takes 10 ms."""


class Overview:
    """The levels of one mosaic, from the one that is reduced by `reduction` to one that fits into a tile."""

    def __init__(self, whole: MosaicGrid, reduction: int) -> None:
        """Begin without pixels; `whole` is the largest grid of the mosaic."""
        self.reduction = reduction
        """By how much the largest level is reduced, a power of two."""
        self.grid = whole.reduced(reduction)
        """The grid of the largest level."""
        self._levels: list[NDArray[Any]] = []

    @property
    def nbytes(self) -> int:
        """Memory of all levels; 0 before the first part with pixels."""
        return sum(level.nbytes for level in self._levels)

    def boxes(self) -> Iterator[Box]:
        """Yield the parts of the largest level, line by line."""
        width, height = self.grid.width, self.grid.height
        for y in range(0, height, BLOCK_PX):
            for x in range(0, width, BLOCK_PX):
                yield x, y, min(x + BLOCK_PX, width), min(y + BLOCK_PX, height)

    def add(self, box: Box, part: NDArray[Any] | None) -> None:
        """Enter a part of the largest level into all levels; None if no frame shows any of it."""
        if part is None:
            return
        if not self._levels:
            self._levels = _empty_levels(self.grid, part)
        x, y = box[:2]
        for n, level in enumerate(self._levels):
            if n:
                part, x, y = halved(part), x // 2, y // 2
            level[y : y + part.shape[0], x : x + part.shape[1]] = part

    def level(self, reduction: int) -> NDArray[Any] | None:
        """Return the board reduced by a factor, 0 where no frame shows it; None if none shows any of it.

        Args:
            reduction: a power of two, at least that of the largest level.
        """
        if not self._levels:
            return None
        steps = (reduction // self.reduction).bit_length() - 1
        picture = self._levels[min(steps, len(self._levels) - 1)]
        for _ in range(steps - len(self._levels) + 1):
            picture = halved(picture)
        return picture

    def cut(self, reduction: int, box: Box) -> NDArray[Any]:
        """Return a part of the board reduced by a factor; see `level`."""
        picture = self.level(reduction)
        x0, y0, x1, y1 = box
        return np.full((y1 - y0, x1 - x0), NODATA, np.uint8) if picture is None else picture[y0:y1, x0:x1]


def halved(picture: NDArray[Any]) -> NDArray[Any]:
    """Average a picture of whole grey levels over blocks of 2 × 2 px, of which only those count that are shown."""
    bottom, right = picture.shape[0] % 2, picture.shape[1] % 2
    even = cv2.copyMakeBorder(picture, 0, bottom, 0, right, cv2.BORDER_CONSTANT, value=[NODATA] * 3)
    h, w = even.shape[0] // 2, even.shape[1] // 2
    half = np.asarray(cv2.resize(even, (w, h), interpolation=cv2.INTER_AREA))
    if even.all():
        return half
    blocks = even.reshape(h, 2, w, 2, -1)
    corners = [even[y::2, x::2].reshape(h, w, -1)[..., 0] != NODATA for y in (0, 1) for x in (0, 1)]
    rows, columns = (np.logical_or.reduce(corners) & ~np.logical_and.reduce(corners)).nonzero()
    few = blocks[rows, :, columns].reshape(len(rows), 4, blocks.shape[-1]).astype(np.uint32)
    shown = np.maximum((few != NODATA).sum(1), 1)
    half[rows, columns] = ((few.sum(1) + shown // 2) // shown).reshape(len(rows), *picture.shape[2:])
    return half


def _empty_levels(grid: MosaicGrid, part: NDArray[Any]) -> list[NDArray[Any]]:
    """Return levels without pixels, of the type and the channels of a part of the first one."""
    levels: list[NDArray[Any]] = []
    # A block of the first level has at least one pixel of its own in the last one.
    for factor in (2**n for n in range(BLOCK_PX.bit_length())):
        size = grid.reduced(factor)
        levels.append(np.full((size.height, size.width, *part.shape[2:]), NODATA, part.dtype))
        if max(size.width, size.height) <= TILE_PX:
            break
    return levels
