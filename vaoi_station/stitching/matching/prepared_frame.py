"""Prepare a frame once for all tasks that read it: compute its grey pixels and its reduced, high-passed copies."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.pixel_formats import eight_bit_grey

_COARSE_WIDTH_PX = 150
"""Smallest width of `PreparedFrame.coarse`."""


class PreparedFrame:
    """One frame with its grey pixels and reduced copies, each of which is computed when it is first read.

    In a copy that is reduced by `factor`, the centre of pixel k lies at the coordinate (k + ½)·factor − ½ of the frame.
    """

    def __init__(self, pixels: NDArray[Any]) -> None:
        """Create it from the pixels of a grey frame (h, w) or a colour frame (h, w, 3), 8 bit or full-scale 16 bit."""
        self._pixels = pixels

    @cached_property
    def grey(self) -> NDArray[np.uint8]:
        """(h, w) 8-bit luminance, as a read-only and contiguous array.

        Numba compiles separate variants for read-only and for writable arrays, and the two may round differently. A
        frame in the ring and the same frame from a file must give the same evidence.
        """
        return read_only(eight_bit_grey(self._pixels))

    @cached_property
    def quarter(self) -> NDArray[np.uint8]:
        """The grey frame reduced by 4 in width and height: means of 4×4 pixels."""
        return read_only(quarter_size(self.grey))

    @cached_property
    def copies(self) -> dict[int, NDArray[np.uint8]]:
        """The cache of `downsampled`: reduced grey frames by their factor."""
        return {}

    @cached_property
    def factor(self) -> int:
        """By how much `coarse` is reduced: 4, or a higher power of two in large frames."""
        factor = 4
        while self.grey.shape[1] // (2 * factor) >= _COARSE_WIDTH_PX:
            factor *= 2
        return factor

    @cached_property
    def coarse(self) -> NDArray[np.float32]:
        """The grey frame reduced by `factor`, minus its local mean, which removes uneven light and vignetting."""
        small = downsampled(self, self.factor)
        wide = cv2.blur(small, (15, 15), borderType=cv2.BORDER_REFLECT)
        return np.asarray(cv2.subtract(small, wide, dtype=cv2.CV_32F), dtype=np.float32)

    @cached_property
    def coarser(self) -> NDArray[np.float32]:
        """The copy `coarse` reduced once more by 2."""
        return np.asarray(half_size(self.coarse))


def downsampled(frame: PreparedFrame, factor: int) -> NDArray[np.uint8]:
    """Return the grey frame reduced by a power of two, by block means, read-only. It is computed once per frame."""
    if factor == 1:
        return frame.grey
    if factor not in frame.copies:
        frame.copies[factor] = frame.quarter if factor == 4 else read_only(half_size(downsampled(frame, factor // 2)))
    return frame.copies[factor]


@compiled
def quarter_size(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the means of blocks of 4×4 pixels. Incomplete blocks at the right and at the bottom are left out.

    This is the first time a frame is read from memory, so that the order of access determines the time. To read line
    by line takes half the time of reading several lines at once, and a third of the time of two reductions by 2.
    """
    h, w = image.shape[0] // 4, image.shape[1] // 4
    out, sums = np.empty((h, w), np.uint8), np.empty(4 * w, np.uint16)
    for y in range(h):
        # four sums are added and divided by 16 below: a start of 2 in each adds 8, which rounds to the nearest
        sums[:] = 2
        for k in range(4):
            line = image[4 * y + k, : 4 * w]
            for x in range(4 * w):
                sums[x] += np.uint16(line[x])
        to = out[y]
        for x in range(w):
            to[x] = np.uint8(np.uint16(sums[4 * x] + sums[4 * x + 1] + sums[4 * x + 2] + sums[4 * x + 3]) >> 4)
    return out


def read_only(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a contiguous, read-only view of an image, so that compiled functions receive a single type of array."""
    view = np.ascontiguousarray(image).view()
    view.flags.writeable = False
    return view


def half_size(image: NDArray[Any]) -> NDArray[Any]:
    """Return the means of blocks of 2×2 pixels.

    An odd last line or column is left out: OpenCV would otherwise stretch the picture, and pixel centres would shift.
    """
    h, w = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    return np.asarray(cv2.resize(image[:h, :w], (w // 2, h // 2), interpolation=cv2.INTER_AREA))
