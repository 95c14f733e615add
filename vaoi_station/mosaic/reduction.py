"""Frames reduced by whole factors, up to and including their last pixels, for tiles of reduced levels."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

BORDER_PX = 1
"""Width of the border around a reduced picture."""


def reduced(pixels: NDArray[Any], factor: int) -> NDArray[Any]:
    """Average a picture (h, w) or (h, w, 3) of 8 or 16 bits over blocks of factor × factor px, rounded.

    The last blocks of lines and columns are averaged over the pixels that there are. Around the result is a border of
    `BORDER_PX` px with the values of the outermost blocks: half a block of what a frame shows lies beyond the centres
    of these, and is interpolated between them and the border.
    """
    h, w = (n // factor * factor for n in pixels.shape[:2])
    rows = [_row(part, w, factor) for part in (pixels[:h], pixels[h:]) if len(part)]
    edge = BORDER_PX
    blocks = rows[0] if len(rows) == 1 else np.concatenate(rows)
    return np.asarray(cv2.copyMakeBorder(blocks, edge, edge, edge, edge, cv2.BORDER_REPLICATE))


def _row(pixels: NDArray[Any], whole: int, factor: int) -> NDArray[Any]:
    """Average lines over blocks of their columns, `whole` of which belong to complete blocks."""
    h = max(len(pixels) // factor, 1)
    parts = [
        np.asarray(cv2.resize(part, (max(part.shape[1] // factor, 1), h), interpolation=cv2.INTER_AREA))
        for part in (pixels[:, :whole], pixels[:, whole:])
        if part.shape[1]
    ]
    return parts[0] if len(parts) == 1 else np.concatenate(parts, 1)
