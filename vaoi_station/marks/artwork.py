"""What a mark looks like: coverage of pixels by its shape, sampled exactly enough for matching."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Shape = Literal["circle", "cross", "square", "diamond"]
_SUBSAMPLES = 8
CROSS_ARM = 0.25
"""Width of a cross' arm as a share of its size, where nothing else is said."""


def coverage(
    shape: Shape, size_px: float, side_px: int, center_px: tuple[float, float] | None = None
) -> NDArray[np.float32]:
    """Share of each pixel that a mark covers, (side, side) in 0…1.

    Args:
        shape: of the mark.
        size_px: diameter of a circle, side of a square, tip to tip of a cross or diamond.
        side_px: side of the picture.
        center_px: of the mark in the picture; its middle by default.
    """
    x, y = center_px or ((side_px - 1) / 2, (side_px - 1) / 2)
    at = (np.arange(side_px * _SUBSAMPLES) + 0.5) / _SUBSAMPLES - 0.5
    inside = _inside(shape, at[None, :] - x, at[:, None] - y, size_px)
    blocks = inside.reshape(side_px, _SUBSAMPLES, side_px, _SUBSAMPLES)
    return np.asarray(blocks.mean((1, 3)), dtype=np.float32)


def _inside(shape: Shape, x: NDArray[np.float64], y: NDArray[np.float64], size: float) -> NDArray[np.bool_]:
    r = size / 2
    if shape == "circle":
        return np.asarray(x * x + y * y <= r * r)
    if shape == "square":
        return np.asarray((np.abs(x) <= r) & (np.abs(y) <= r))
    if shape == "diamond":
        return np.asarray(np.abs(x) + np.abs(y) <= r)
    arm = r * CROSS_ARM
    return np.asarray(((np.abs(x) <= r) & (np.abs(y) <= arm)) | ((np.abs(x) <= arm) & (np.abs(y) <= r)))
