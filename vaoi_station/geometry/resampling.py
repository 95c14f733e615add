"""Bilinear resampling of frames into pictures, several of one frame at once.

Cameras are mounted upright to a degree or so, and most pictures have about the resolution of the frame. Along a line of
such a picture the position in the frame advances by almost one pixel per pixel, so the four neighbours of many pixels
in turn are four runs of values in memory. For frames of 8 bits a compiled loop takes them into vector registers, in
less than half of the time of `cv2.warpPerspective`. OpenCV makes all other pictures.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.homographies import of_part, to_part
from vaoi_station.geometry.transforms import Floats, apply

_FLAGS = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
_EXACT_PX = 64
"""Longest side of the parts in which OpenCV resamples frames of 16 bits.

It computes places in single precision. At 2000 px from the origin, their error is 0.0001 px, which moves an edge of
65535 grey levels by more than one. In a part with its own origin, the error is 30 times as small."""
_BLOCK = 16
"""Number of values that are computed at once, and largest number that may be written beyond those of the pictures."""
_BENT_PX = 0.0018
"""Largest deviation of a homography from the linear function that replaces it over part of a line.

It is less than half a grey level of 255 at the steepest edge, so that with rounding it stays within one grey level."""
_LONGEST_PX, _SHORTEST_PX = 1024, 32
"""Longest such part, and the shortest that is worth it."""
_STEEPEST = 0.04
"""Largest deviation of the steps along a line from one pixel to the right: runs would be shorter than 25 px."""
_BELOW_1 = 1 - 1e-9
_NO_STEP = 1e-12
"""Smaller changes of position per pixel are none: over a line they come to a thousand-millionth of a pixel."""
_BAND_PX, _CACHE_LINE = 64, 64
"""Lines of a picture that are read ahead, and the bytes that the processor reads from memory at once."""


def resampled(frame: NDArray[Any], matrices: Floats, sizes: NDArray[np.int64]) -> list[NDArray[Any]]:
    """Resample a frame into k pictures, (height, width) or (height, width, channels), of the frame's type.

    Every pixel is the bilinear interpolation, within one grey level. Places outside the frame are black; within one
    pixel of its border the pictures fade to black. The pictures are parts of one array.

    Args:
        frame: (rows, columns) or (rows, columns, channels).
        matrices: (k, 3, 3) homographies from pixels of the pictures to those of the frame.
        sizes: (k, 2) width and height of the pictures.
    """
    shape, kind, sides = frame.shape[2:], frame.dtype, sizes.tolist()
    places = np.empty((len(sides), 4), np.int64)
    ends = sizes.prod(1).cumsum()
    places[:, 0], places[1:, 0], places[:, 1], places[:, 2:] = 0, ends[:-1], sizes[:, 0], sizes
    out = np.empty(int(ends[-1]) * math.prod(shape) + _BLOCK, kind)
    starts = (places[:, 0] * (math.prod(shape) * kind.itemsize)).tolist()
    pictures = [np.ndarray((h, w, *shape), kind, out, at) for (w, h), at in zip(sides, starts, strict=True)]
    for k in _write(frame, matrices, places, out):
        _warp(frame, matrices[k], pictures[k])
    return pictures


def resampled_in_tiles(frame: NDArray[Any], matrices: Floats, boxes: NDArray[np.int64]) -> NDArray[Any]:
    """Resample a frame into a picture of k tiles, each by its own matrix; otherwise as `resampled`.

    Args:
        frame: (rows, columns) or (rows, columns, channels).
        matrices: (k, 3, 3) homographies from pixels of the tiles to those of the frame.
        boxes: (k, 4) first column and row of the tiles, and those after their last; the last one ends where the picture
            ends.
    """
    width, height = boxes[-1, 2:].tolist()
    # One column of tiles has no gaps between its lines: the loop writes beyond their last, as in `resampled`.
    count = height * width * math.prod(frame.shape[2:])
    out = np.empty(count + _BLOCK, frame.dtype)
    picture = out[:count].reshape(height, width, *frame.shape[2:])
    places = np.column_stack(
        [boxes[:, 0] + boxes[:, 1] * width, np.full(len(boxes), width), boxes[:, 2:] - boxes[:, :2]]
    )
    for k in _write(frame, matrices, places, out):
        x0, y0, x1, y1 = boxes[k].tolist()
        _warp(frame, matrices[k], picture[y0:y1, x0:x1])
    return picture


def _write(frame: NDArray[Any], matrices: Floats, places: NDArray[np.int64], out: NDArray[Any]) -> list[int]:
    """Write pictures by the compiled loop; return the numbers of those that it cannot make."""
    if frame.dtype != np.uint8 or not frame.flags.c_contiguous:
        return list(range(len(places)))
    lines = frame.reshape(len(frame), -1)
    # Numba compiles separate versions for writeable and read-only arrays, so all frames are passed as read-only.
    lines.flags.writeable = False
    values = math.prod(frame.shape[2:])
    # Few different lengths are kept.
    step = _pixel_of_value(2 ** int(places[:, 2].max() + _BLOCK).bit_length(), values)
    done = np.zeros(len(places), np.bool_)
    _resample(lines, values, np.array(matrices, np.float64, order="C"), places, step, out, done)
    return [] if done.all() else np.flatnonzero(~done).tolist()


@lru_cache(maxsize=32)
def _pixel_of_value(pixels: int, channels: int) -> NDArray[np.float32]:
    """Return the number of the pixel to which each value of a line belongs: all values of a pixel have its weights."""
    return np.repeat(np.arange(pixels, dtype=np.float32), channels)


def _warp(frame: NDArray[Any], matrix: Floats, picture: NDArray[Any]) -> None:
    """Resample a frame by OpenCV into a picture."""
    height, width = picture.shape[:2]
    if frame.dtype != np.uint16:
        # WARP_INVERSE_MAP: the matrix maps the picture to the frame already.
        cv2.warpPerspective(frame, matrix, (width, height), dst=picture, flags=_FLAGS)
        return
    limits = np.array(frame.shape[1::-1])
    for top in range(0, height, _EXACT_PX):
        for left in range(0, width, _EXACT_PX):
            part, own = picture[top : top + _EXACT_PX, left : left + _EXACT_PX], of_part(matrix, left, top)
            h, w = part.shape[:2]
            raw = apply(own, np.array([(0, 0), (w - 1, 0), (w - 1, h - 1), (0, h - 1)], np.float64))
            low = np.clip(np.floor(raw.min(0)) - 1, 0, limits - 1).astype(int)
            high = np.clip(np.ceil(raw.max(0)) + 2, low + 1, limits).astype(int)
            shown = frame[low[1] : high[1], low[0] : high[0]]
            cv2.warpPerspective(shown, to_part(own, *low.tolist()), (w, h), dst=part, flags=_FLAGS)


@inlined
def chord_px(m: Floats, x: float, y: float) -> int:
    """Return over how many pixels from a place on a chord may replace a homography along a line."""
    # A chord of n pixels deviates by n²/8 times the second derivative, which is 2·m20/w times the first.
    w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
    return int(min(max(np.sqrt(3 * _BENT_PX * abs(w) / (abs(m[2, 0]) + 1e-12)), 1.0), _LONGEST_PX))


@inlined
def chord(m: Floats, x: int, y: int, count: int) -> tuple[float, float, float, float]:
    """Return the position in the frame of a pixel, and its change per pixel along the line, less 1 to the right."""
    w0, end = 1 / (m[2, 0] * x + m[2, 1] * y + m[2, 2]), x + count
    w1 = 1 / (m[2, 0] * end + m[2, 1] * y + m[2, 2])
    u, v = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) * w0, (m[1, 0] * x + m[1, 1] * y + m[1, 2]) * w0
    du = ((m[0, 0] * end + m[0, 1] * y + m[0, 2]) * w1 - u) / count - 1
    dv = ((m[1, 0] * end + m[1, 1] * y + m[1, 2]) * w1 - v) / count
    # `run_at` divides by them, and the reciprocal of a denormal number is infinite.
    return u, v, du if abs(du) > _NO_STEP else 0.0, dv if abs(dv) > _NO_STEP else 0.0


@inlined
def run_at(u: float, v: float, du: float, dv: float, most: int) -> tuple[int, int, float, float, int]:
    """Return the run of pixels from a position on whose neighbours in the frame are runs of pixels as well.

    It has the column and row of the neighbour above and to the left of its first pixel, the weights there of the
    neighbours to the right and below, and the number of pixels.
    """
    left, top = int(np.floor(u)), int(np.floor(v))
    # Rounded, a difference may be 1.
    right, down, count = min(u - left, _BELOW_1), min(v - top, _BELOW_1), most
    if not 0 <= right + du * (most - 1) < 1:
        count = min(count, int((1 - right) / du) + 1 if du > 0 else int(right / -du) + 1)
    if not 0 <= down + dv * (most - 1) < 1:
        count = min(count, int((1 - down) / dv) + 1 if dv > 0 else int(down / -dv) + 1)
    return left, top, right, down, count


@compiled
def _resample(  # noqa: PLR0912, PLR0915  (one compiled function; helpers would be compiled as well)
    frame: NDArray[np.uint8],
    channels: int,
    matrices: Floats,
    places: NDArray[np.int64],
    step: NDArray[np.float32],
    out: NDArray[np.uint8],
    done: NDArray[np.bool_],
) -> None:
    """Resample a frame into k pictures, rounded; state in `done` (k,) which were written.

    A picture is not written if its lines do not run along those of the frame, or if its resolution is another one.

    Args:
        frame: (rows, columns · channels), read-only.
        channels: number of values of a pixel.
        matrices: (k, 3, 3) homographies from pixels of the pictures to those of the frame.
        places: (k, 4) first pixel in `out`, pixels from one line to the next, width and height. Pictures whose lines
            follow each other without a gap lie in this order.
        step: number of the pixel to which each value belongs, for at least the longest line and `_BLOCK` values more.
        out: the values of all pictures, and `_BLOCK` more if their lines follow each other.
        done: output.
    """
    rows, columns, source = frame.shape[0], frame.shape[1] // channels, frame.reshape(-1)
    pitch, beside, half = np.uint64(frame.shape[1]), np.uint64(channels), np.float32(0.5)
    for k in range(len(matrices)):
        begin, gap, width, height, m = places[k, 0], places[k, 1], places[k, 2], places[k, 3], matrices[k]
        fits, longest = True, _LONGEST_PX
        for corner in range(4):
            x, y = (corner % 2) * (width - 1), (corner // 2) * (height - 1)
            w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
            u, v = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / w, (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / w
            du, dv = (m[0, 0] - m[2, 0] * u) / w, (m[1, 0] - m[2, 0] * v) / w
            fits &= w > 0 and abs(du - 1) < _STEEPEST and abs(dv) < _STEEPEST
            longest = min(longest, chord_px(m, x, y))
        done[k] = fits and longest >= min(_SHORTEST_PX, width)
        if not done[k]:
            continue
        parts = (width - 1) // longest + 1
        length = (width - 1) // parts + 1
        for y in range(height):
            if y % _BAND_PX == 0:
                # Lines of a picture are far apart in the frame. Read together, none waits for another.
                seen = 0
                for below in range(y, min(y + _BAND_PX, height)):
                    w = 1 / (m[2, 1] * below + m[2, 2])
                    row, column = int((m[1, 1] * below + m[1, 2]) * w), int((m[0, 1] * below + m[0, 2]) * w)
                    if 0 <= row < rows:
                        line = row * frame.shape[1]
                        last = line + min(max(column + width, 0), columns - 1) * channels
                        for j in range(line + max(column, 0) * channels, last, _CACHE_LINE):
                            seen += source[j]
                        seen += source[last]
                # Stored, so that the compiler keeps the reads; the value is written again below.
                out[(begin + y * gap) * channels] = seen & 1
            for x0 in range(0, width, length):
                some = min(length, width - x0)
                u, v, du, dv = chord(m, x0, y, some)
                x = 0
                while x < some:
                    left, top, right, down, count = run_at(u + x * (du + 1), v + x * dv, du, dv, some - x)
                    at = np.uint64((begin + y * gap + x0 + x) * channels)
                    s0, t0, ds, dt = np.float32(right), np.float32(down), np.float32(du), np.float32(dv)
                    values, offset = count * channels, top * frame.shape[1] + left * channels
                    # What is written beyond a run is written again by the next one, except at the end of a tile's line.
                    room = values + _BLOCK if gap == width else (width - x0 - x) * channels
                    inside = left >= 0 and top >= 0 and left + count < columns and top + 1 < rows and room >= _BLOCK
                    if inside and offset + values + frame.shape[1] + channels + _BLOCK <= len(source):
                        # Unsigned: the compiler uses vector registers only if no index can be negative.
                        first = np.uint64(offset)
                        for block in range(0, values, _BLOCK):
                            shifted = min(block, room - _BLOCK)
                            for n in range(_BLOCK):
                                i = np.uint64(shifted + n)
                                upper, lower = first + i, first + i + pitch
                                a, b = np.float32(source[upper]), np.float32(source[upper + beside])
                                c, d = np.float32(source[lower]), np.float32(source[lower + beside])
                                s, t = s0 + ds * step[i], t0 + dt * step[i]
                                a += s * (b - a)
                                c += s * (d - c)
                                out[at + i] = np.uint8(np.int32(a + t * (c - a) + half))
                    elif left >= columns or top >= rows or left + count < 0 or top < -1:
                        for each in range(values):
                            out[int(at) + each] = 0
                    else:
                        # At the border of the frame; pixels beside it are black.
                        for each in range(values):
                            s, t, value = s0 + ds * step[each], t0 + dt * step[each], half
                            for corner in range(4):
                                j, column, row = corner % 2, left + int(step[each]) + corner % 2, top + corner // 2
                                if 0 <= column < columns and 0 <= row < rows:
                                    share = (s if j else 1 - s) * (t if corner > 1 else 1 - t)
                                    value += share * frame[row, column * channels + each % channels]
                            out[int(at) + each] = np.uint8(value)
                    x += count
