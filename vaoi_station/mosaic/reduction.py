"""Frames reduced by powers of two, up to and including their last pixels: for plans and for tiles of reduced levels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined

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

    The factor is a power of two. A picture that is not reduced yet is `Reduced(pixels, pixels)`.
    """
    if factor == 1:
        return picture
    lines = [np.ascontiguousarray(part).reshape(len(part), -1).view() for part in picture]
    for part in lines:
        # Numba compiles separate versions for writeable and read-only arrays, so all are passed as read-only.
        part.flags.writeable = False
    h, w = (-(-n // factor) for n in picture.means.shape[:2])
    colours = picture.means.shape[2:]
    channels = colours[0] if colours else 1
    means, largest = (np.empty((h, w * channels), picture.means.dtype) for _ in range(2))
    # The sum of a block of 16 × 16 px of 8 bits fits into 16.
    sums = np.empty((2, lines[0].shape[1]), np.uint16 if means.dtype == np.uint8 and factor <= 16 else np.uint32)
    _reduce(lines[0], lines[1], factor, channels, sums, means, largest)
    return Reduced(means.reshape(h, w, *colours), largest.reshape(h, w, *colours))


@compiled
def _reduce(
    pixels: NDArray[Any],
    tops: NDArray[Any],
    factor: int,
    channels: int,
    sums: NDArray[Any],
    means: NDArray[Any],
    largest: NDArray[Any],
) -> None:
    """Average lines (h, w · channels) over blocks, and find the largest of `tops` (h, w · channels) in each.

    Args:
        pixels: what is averaged.
        tops: what the largest is found of.
        factor: side of the blocks, a power of two.
        channels: 1 grey, 3 colour.
        sums: (2, w · channels) memory for sums.
        means: (rows of blocks, columns of blocks · channels) output.
        largest: output of the same shape.
    """
    h, w = pixels.shape
    most = np.empty((2, w), tops.dtype)
    for row in range(len(means)):
        first, end = row * factor, min((row + 1) * factor, h)
        # Over contiguous lines, and over pairs of neighbours in them, the compiler uses vector registers.
        total, top = sums[0], most[0]
        line, high = pixels[first], tops[first]
        for x in range(w):
            total[x] = line[x]
            top[x] = high[x]
        for y in range(first + 1, end):
            line, high = pixels[y], tops[y]
            for x in range(w):
                total[x] += line[x]
                top[x] = max(top[x], high[x])
        width, side, now = w // channels, 1, 0
        while side < factor:
            _join_pairs(sums[now], sums[1 - now], width, channels)
            _join_largest(most[now], most[1 - now], width, channels)
            width, side, now = (width + 1) // 2, 2 * side, 1 - now
        found, high = sums[now], most[now]
        whole, share = w // channels // factor * channels, np.float32(1.0 / ((end - first) * factor))
        for x in range(whole):
            means[row, x] = np.int32(np.float32(found[x]) * share + np.float32(0.5))
        left = (end - first) * (w // channels % factor)
        for x in range(whole, width * channels):
            means[row, x] = np.int32(found[x] / left + 0.5)
        for x in range(width * channels):
            largest[row, x] = high[x]


@inlined
def _join_pairs(values: NDArray[Any], out: NDArray[Any], width: int, channels: int) -> None:
    """Add the neighbours of each pair of pixels of a line; the last pixel of an odd number stays alone."""
    half = width // 2
    if channels == 1:
        for n in range(half):
            # Unsigned numbers, because the compiler uses vector registers only if no index can be negative.
            at = np.uint64(2) * np.uint64(n)
            out[n] = values[at] + values[at + np.uint64(1)]
    else:
        for n in range(half):
            for c in range(channels):
                out[n * channels + c] = values[2 * n * channels + c] + values[(2 * n + 1) * channels + c]
    for c in range(width % 2 * channels):
        out[half * channels + c] = values[2 * half * channels + c]


@inlined
def _join_largest(values: NDArray[Any], out: NDArray[Any], width: int, channels: int) -> None:
    """Take the larger one of each pair of pixels of a line; the last pixel of an odd number stays alone."""
    half = width // 2
    if channels == 1:
        for n in range(half):
            at = np.uint64(2) * np.uint64(n)
            out[n] = max(values[at], values[at + np.uint64(1)])
    else:
        for n in range(half):
            for c in range(channels):
                out[n * channels + c] = max(values[2 * n * channels + c], values[(2 * n + 1) * channels + c])
    for c in range(width % 2 * channels):
        out[half * channels + c] = values[2 * half * channels + c]
