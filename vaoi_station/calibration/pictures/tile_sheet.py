"""Arrangement of the pictures of single cameras on one sheet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
"""An image (h, w, 3) in BGR order."""
GAP = 8


def arrange_tiles(tiles: Sequence[Picture]) -> Picture:
    """Arrange tiles of equal width on a white sheet: three per line, or four per line for more than six tiles."""
    columns = min(len(tiles), 4 if len(tiles) > 6 else 3)
    lines = [tiles[k : k + columns] for k in range(0, len(tiles), columns)]
    heights = [max(t.shape[0] for t in line) for line in lines]
    wide = tiles[0].shape[1]
    sheet = np.full((sum(heights) + GAP * (len(lines) - 1), columns * (wide + GAP) - GAP, 3), 255, np.uint8)
    y = 0
    for line, height in zip(lines, heights, strict=True):
        for k, tile in enumerate(line):
            x = k * (wide + GAP)
            sheet[y : y + tile.shape[0], x : x + wide] = tile
        y += height + GAP
    return sheet
