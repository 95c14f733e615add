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


def coverage(shape: Shape, size_px: float, side_px: int, arm: float = CROSS_ARM) -> NDArray[np.float32]:
    """Compute the share (0…1) of each pixel that a mark in the middle of an image (side_px, side_px) covers.

    `size_px` is the diameter of a circle, the side of a square, or the length of a cross or diamond from tip to tip.
    """
    x = np.abs(np.arange(side_px, dtype=np.float32) - np.float32((side_px - 1) / 2))
    y, r = x[:, None], size_px / 2
    thin = r * arm
    outside = {
        "circle": np.sqrt(x * x + y * y) - r,
        "square": np.maximum(x, y) - r,
        "diamond": (x + y - r) / np.float32(np.sqrt(2)),
        "cross": np.minimum(np.maximum(x - r, y - thin), np.maximum(x - thin, y - r)),
    }[shape]
    return np.asarray(np.clip(0.5 - outside, 0, 1), dtype=np.float32)
