"""Where in a frame something looks like a mark: one correlation at a size where the mark is a few pixels wide.

The compared square is the one that fits into the bare rim, so that what lies beyond does not matter.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks.artwork import CROSS_ARM, Shape, coverage

SURROUND = 2.0
"""Diameter of the compared disc in sizes of the mark: the mark, and the bare rim that board makers leave around it."""
_SMALLEST_PX = 5.0
_LEAST_SCORE = 0.75


def reduction(size_px: float) -> int:
    """By which power of two a frame may be reduced so that the mark keeps five pixels."""
    return 2 ** max(int(math.log2(size_px / _SMALLEST_PX)), 0) if size_px > _SMALLEST_PX else 1


def search(
    image: NDArray[np.uint8], shape: Shape, size_px: float, most: int = 16, *, arm: float = CROSS_ARM
) -> tuple[Floats, Floats]:
    """Candidates for a mark, light on dark or dark on light.

    Args:
        image: (h, w), reduced so that `size_px` is at least about five.
        shape: of the mark.
        size_px: of the mark in this image.
        most: how many candidates at the most, the best first.
        arm: width of a cross' arm as a share of its size.

    Returns:
        Positions (k, 2) in pixels of `image`, good to about half a pixel, and scores (k,) in 0…1.
    """
    side = max(2 * round(SURROUND / math.sqrt(2) * size_px / 2) + 1, 7)
    if min(image.shape) < side:
        return np.zeros((0, 2)), np.zeros(0)
    template = np.round(coverage(shape, size_px, side, arm=arm) * 200 + 20).astype(np.uint8)
    surface = np.abs(cv2.matchTemplate(image, template, cv2.TM_CCOEFF_NORMED))
    surface[~(surface <= 1)] = 0  # windows without any contrast
    near = max(round(size_px / 2), 1)
    peaks = (surface == cv2.dilate(surface, np.ones((2 * near + 1, 2 * near + 1)))) & (surface >= _LEAST_SCORE)
    y, x = np.nonzero(peaks)
    best = np.argsort(-surface[y, x], kind="stable")[:most]
    places = np.stack([x[best], y[best]], -1).astype(np.float64) + (side - 1) / 2
    return places, surface[y[best], x[best]].astype(np.float64)
