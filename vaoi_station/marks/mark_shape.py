"""The shapes of marks, rendered as images of the share of each pixel that the shape covers.

The share is computed from the distance of the pixel's centre to the outline. It is ½ if the outline passes through the
centre. It is exact along edges parallel to the axes. For a circle of five pixels its error is a few thousandths.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Shape = Literal["circle", "cross", "square", "diamond"]
CROSS_ARM = 0.25
"""Default width of a cross' arm, as a share of its size."""


def coverage(
    shape: Shape, size_px: float, side_px: int, center_px: tuple[float, float] | None = None, arm: float = CROSS_ARM
) -> NDArray[np.float32]:
    """Compute the share (0…1) of each pixel that a mark covers, as an image (side_px, side_px).

    Args:
        shape: shape of the mark.
        size_px: diameter of a circle, side of a square, or length of a cross or diamond from tip to tip.
        side_px: side of the square image.
        center_px: centre of the mark; by default the centre of the image.
        arm: width of a cross' arm as a share of its size.
    """
    x, y = center_px or ((side_px - 1) / 2, (side_px - 1) / 2)
    at = np.arange(side_px, dtype=np.float32)
    distance = _distance(shape, at[None, :] - np.float32(x), at[:, None] - np.float32(y), size_px, arm)
    return np.asarray(np.clip(0.5 - distance, 0, 1), dtype=np.float32)


def _distance(
    shape: Shape, x: NDArray[np.float32], y: NDArray[np.float32], size: float, arm_share: float
) -> NDArray[np.float32]:
    """Compute the distance of points (x, y) to the outline of a shape centred at (0, 0). It is negative inside."""
    r = size / 2
    if shape == "circle":
        return np.asarray(np.sqrt(x * x + y * y) - r)
    if shape == "square":
        return np.asarray(np.maximum(np.abs(x), np.abs(y)) - r)
    if shape == "diamond":
        return np.asarray((np.abs(x) + np.abs(y) - r) / np.float32(np.sqrt(2)))
    # A cross is the union of two rectangles, so its distance is the smaller one of their distances.
    arm = r * arm_share
    across = np.maximum(np.abs(x) - r, np.abs(y) - arm)
    along = np.maximum(np.abs(x) - arm, np.abs(y) - r)
    return np.asarray(np.minimum(across, along))
