"""The overview of a mosaic: its reduced levels, made with its plan, from which tiles are cut without frames.

Each level is half as large as the one before: a pixel is the mean of those of 2 × 2 px that some frame shows.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.mosaic.deep_zoom import TILE_PX, Box
from vaoi_station.mosaic.tiles import NODATA


class Overview:
    """The levels of one mosaic, from the one that is reduced by `reduction` to one that fits into a tile."""

    def __init__(self, picture: NDArray[Any] | None, reduction: int) -> None:
        """Halve a mosaic that is reduced by `reduction`, a power of two, until it fits into a tile.

        `picture` is None if no frame shows any of the board.
        """
        self.reduction = reduction
        """By how much the largest level is reduced."""
        self._levels = [] if picture is None else [picture]
        while self._levels and max(self._levels[-1].shape[:2]) > TILE_PX:
            self._levels.append(halved(self._levels[-1]))

    @property
    def nbytes(self) -> int:
        """Memory of all levels."""
        return sum(level.nbytes for level in self._levels)

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
