"""Frames reduced by powers of two, up to and including their last pixels: for plans and for tiles of reduced levels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

BORDER_PX = 1
"""Width of the border around a reduced picture."""


class Reduced(NamedTuple):
    """A picture (h, w) or (h, w, 3) of 8 or 16 bits, averaged over blocks of pixels."""

    means: NDArray[Any]
    """Mean of each block, rounded."""
    largest: NDArray[Any]
    """Largest pixel of each block: the mean of a block with saturated pixels is not saturated itself."""

    def part(self, box: tuple[int, int, int, int]) -> Reduced:
        """Return a part x0, y0, x1, y1 of the picture, ends excluded."""
        x0, y0, x1, y1 = box
        return Reduced(self.means[y0:y1, x0:x1], self.largest[y0:y1, x0:x1])

    def bordered(self) -> Reduced:
        """Return the picture with a border of `BORDER_PX` px that has the values of its outermost pixels.

        Half a block of what a frame shows lies beyond the centres of the outermost blocks, and is interpolated between
        them and the border.
        """
        n = BORDER_PX
        return Reduced(*(np.asarray(cv2.copyMakeBorder(p, n, n, n, n, cv2.BORDER_REPLICATE)) for p in self))


def shrunk(pixels: NDArray[Any], factor: int) -> NDArray[Any]:
    """Return a picture averaged over blocks of factor × factor px; what is left at the end is cut off."""
    if factor <= 1:
        return pixels
    h, w = (n // factor for n in pixels.shape[:2])
    return np.asarray(cv2.resize(pixels[: h * factor, : w * factor], (w, h), interpolation=cv2.INTER_AREA))


class ReducedFrames(NamedTuple):
    """Frames of a run that are reduced already."""

    factor: int
    """By how much, a power of two."""
    frames: Mapping[tuple[int, int], Reduced]
    """By camera and row."""


def reduced(picture: Reduced, factor: int) -> Reduced:
    """Average a picture over blocks of factor × factor px, the last ones over the pixels that there are.

    A picture that is not reduced yet is `Reduced(pixels, pixels)`.
    """
    if factor == 1:
        return picture
    (height, width), colours = picture.means.shape[:2], picture.means.shape[2:]
    h, w = -(-height // factor), -(-width // factor)
    means = np.empty((h, w, *colours), picture.means.dtype)
    # Whole blocks, and what is left of the last ones.
    for y, below in ((0, height // factor * factor), (height // factor * factor, height)):
        for x, right in ((0, width // factor * factor), (width // factor * factor, width)):
            if y < below and x < right:
                size = -(-(right - x) // factor), -(-(below - y) // factor)
                part = cv2.resize(picture.means[y:below, x:right], size, interpolation=cv2.INTER_AREA)
                at_x, at_y = x // factor, y // factor
                means[at_y : at_y + size[1], at_x : at_x + size[0]] = part
    rest = 0, h * factor - height, 0, w * factor - width
    padded = np.asarray(cv2.copyMakeBorder(picture.largest, *rest, cv2.BORDER_REPLICATE))
    lines = padded.reshape(h, factor, -1).max(1)
    return Reduced(means, lines.reshape(h, w, factor, *colours).max(2))
