"""Prepare a frame once for all its tasks: grey pixels and small high-passed copies."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled

_COARSE_WIDTH_PX = 150
"""Least width of `coarse`."""


class PreparedFrame:
    """One frame and its copies, each computed when it is first needed.

    The centre of pixel k of a copy lies at (k + ½)·factor − ½ of the frame.
    """

    def __init__(self, pixels: NDArray[Any]) -> None:
        """Take a frame (h, w) or (h, w, 3), 8 or 16 bit."""
        self._pixels = pixels

    @cached_property
    def grey(self) -> NDArray[np.uint8]:
        """(h, w) 8-bit luminance, read-only and contiguous, from any source.

        Numba compiles a second variant for writable arrays, and the two may round differently. A frame in the ring
        and the same frame from a file must give the same evidence.
        """
        return read_only(to_eight_bit(to_grey(self._pixels)))

    @cached_property
    def quarter(self) -> NDArray[np.uint8]:
        """A fourth of the size, by block means."""
        return read_only(quarter_size(self.grey))

    @cached_property
    def copies(self) -> dict[int, NDArray[np.uint8]]:
        """The results of `downsampled`, by factor."""
        return {}

    @cached_property
    def factor(self) -> int:
        """Size of a pixel of `coarse` in pixels of the frame."""
        factor = 4
        while self.grey.shape[1] // (2 * factor) >= _COARSE_WIDTH_PX:
            factor *= 2
        return factor

    @cached_property
    def coarse(self) -> NDArray[np.float32]:
        """A small copy minus its local mean, so that light and vignetting cancel."""
        small = downsampled(self, self.factor)
        wide = cv2.blur(small, (15, 15), borderType=cv2.BORDER_REFLECT)
        return np.asarray(cv2.subtract(small, wide, dtype=cv2.CV_32F), dtype=np.float32)

    @cached_property
    def coarser(self) -> NDArray[np.float32]:
        """Half the size of `coarse`."""
        return np.asarray(half_size(self.coarse))


def downsampled(frame: PreparedFrame, factor: int) -> NDArray[np.uint8]:
    """Return the frame reduced by a power of two, by block means, read-only; computed once."""
    if factor == 1:
        return frame.grey
    if factor not in frame.copies:
        frame.copies[factor] = frame.quarter if factor == 4 else read_only(half_size(downsampled(frame, factor // 2)))
    return frame.copies[factor]


def to_grey(pixels: NDArray[Any]) -> NDArray[Any]:
    """Return the luminance of a colour frame, or a grey frame unchanged."""
    return pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY))


def to_eight_bit(grey: NDArray[Any]) -> NDArray[np.uint8]:
    """Convert to 8 bit; 16-bit frames, of which cameras fill 10, 12 or 16 bits, are scaled by the bits in use."""
    if grey.dtype == np.uint8:
        return grey
    bits = max(int(grey.max()).bit_length(), 8)
    bits = next(b for b in (8, 10, 12, 14, 16) if b >= bits)
    return np.asarray(grey >> (bits - 8), dtype=np.uint8)


@compiled
def quarter_size(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return block means of 4×4; a remainder at the right and at the bottom is left out.

    This is the first read of a frame from memory, so that its order of access decides: line by line takes half the
    time of several lines at once, and a third of two halvings.
    """
    h, w = image.shape[0] // 4, image.shape[1] // 4
    out, sums = np.empty((h, w), np.uint8), np.empty(4 * w, np.uint16)
    for y in range(h):
        # 2 in each of four sums rounds their sixteenth to the nearest
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
    """Return a contiguous, read-only view, so that compiled functions see a single type of array."""
    view = np.ascontiguousarray(image).view()
    view.flags.writeable = False
    return view


def half_size(image: NDArray[Any]) -> NDArray[Any]:
    """Return block means of 2×2; an odd last row or column is left out, so that pixel centres stay aligned."""
    h, w = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    return np.asarray(cv2.resize(image[:h, :w], (w // 2, h // 2), interpolation=cv2.INTER_AREA))
