"""What every task wants of a frame, made once: grey pixels and small high-passed copies."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_COARSE_WIDTH_PX = 150
"""The coarsest copy is at least this wide."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """One frame and its copies; the centre of pixel k of a copy lies at (k + ½)·factor − ½ of the frame."""

    grey: NDArray[Any]
    """(h, w) uint8, or uint16 scaled to its own range by `to_eight_bit`."""
    quarter: NDArray[np.uint8]
    """A fourth of the size, block means."""
    factor: int
    """Size of a pixel of `coarse` in pixels of the frame."""
    coarse: NDArray[np.float32]
    """High-passed: the local mean is taken off, so that light and vignetting do not matter."""

    @cached_property
    def corners(self) -> NDArray[np.float32]:
        """Smaller eigenvalue of the structure tensor of `quarter`: how well a place is fixed in both directions."""
        return np.asarray(cv2.cornerMinEigenVal(self.quarter, 3, ksize=3), dtype=np.float32)


def prepare(pixels: NDArray[Any]) -> Prepared:
    """Make the copies of a frame (h, w) or (h, w, 3), 8 or 16 bit."""
    grey = to_eight_bit(to_grey(pixels))
    half = halved(grey)
    quarter = halved(half)
    small, factor = quarter, 4
    while small.shape[1] // 2 >= _COARSE_WIDTH_PX:
        small, factor = halved(small), factor * 2
    wide = cv2.blur(small, (15, 15), borderType=cv2.BORDER_REFLECT)
    coarse = cv2.subtract(small, wide, dtype=cv2.CV_32F)
    return Prepared(grey, quarter, factor, np.asarray(coarse, dtype=np.float32))


def to_grey(pixels: NDArray[Any]) -> NDArray[Any]:
    """Luminance of a colour frame; a grey one as it is."""
    return pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY))


def to_eight_bit(grey: NDArray[Any]) -> NDArray[np.uint8]:
    """8-bit grey; 16-bit frames, whose cameras fill 10, 12 or 16 of the bits, are scaled by the bits in use."""
    if grey.dtype == np.uint8:
        return grey
    bits = max(int(grey.max()).bit_length(), 8)
    bits = next(b for b in (8, 10, 12, 14, 16) if b >= bits)
    return np.asarray(grey >> (bits - 8), dtype=np.uint8)


def halved(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Block means of 2×2; an odd last row or column is left out, so that pixel centres stay in step."""
    h, w = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    return np.asarray(cv2.resize(image[:h, :w], (w // 2, h // 2), interpolation=cv2.INTER_AREA), dtype=np.uint8)
