"""Bilinear resampling of frames whose pixels lie almost as those of a picture: runs of pixels are shifted.

Pictures have about the resolution of the cameras, and cameras are mounted upright to a degree or so. Along a line of
the picture, the position in the frame then advances by almost one pixel per pixel, so that the four neighbours of many
pixels in turn are four runs of values in memory. The compiler uses vector registers for them, which takes half of the
time of `cv2.warpPerspective` or less. Over a small picture a homography is linear to a thousandth of a pixel
(`linear_part` states how far it is not): one linear function then replaces it, which takes a third of the time again.
The module is imported on first use, because Numba takes a moment to load.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats

_RUN_PX, _LEAST_RUN_PX = 256, 32
"""Largest length of a run, and the smallest that is worth it; positions are linear within a run."""
BENT = 0.0018
"""Largest deviation of a homography from a linear function within a run or a picture, px.

It is less than half a grey level of 255 at the steepest edge, so that with rounding it stays within one grey level."""
_STEEPEST = 0.04
"""Largest deviation of the steps along a line from one pixel to the right: runs would be shorter than 25 px."""
_BLOCK = 16  # values that are computed at once: a known number, for which the compiler makes no loop for a rest
_CACHE_LINE = 64  # bytes that the processor reads from memory at once
_BAND_PX = 64  # lines of a picture that are read ahead together: with their width, they fit into the fastest cache
_CLEAR_PX = 1e-6  # distance from the border of a frame that positions keep; it exceeds every error of rounding


class Run(NamedTuple):
    """Pixels of one line whose neighbours in the frame are runs of values as well."""

    left: int  # column and row in the frame of the neighbour above and to the left of the first pixel
    top: int
    right: float  # weights of the neighbours to the right and below, at the first pixel
    down: float
    step_right: float  # change of these weights from one pixel to the next
    step_down: float
    length: int  # number of pixels


class Linear(NamedTuple):
    """A linear function from pixels of a picture to those of a frame, and how far a homography is from it."""

    u: float  # column and row in the frame of the first pixel
    v: float
    u_x: float  # change of column and row per pixel along x and along y
    v_x: float
    u_y: float
    v_y: float
    bent: float
    """Bound of the homography's deviation over the picture, in u and v together, px; infinite if it has a pole."""


@inlined
def linear_part(m: Floats, width: int, height: int) -> Linear:
    """Return the linear part of a homography at the centre of a picture of this size, with its deviation.

    At an offset d from the centre, with Jacobian J and denominator w + g·d, the homography is off by −J d · g·d /
    (w + g·d), exactly. Both J d and g·d are largest at corners.
    """
    x, y = (width - 1) / 2, (height - 1) / 2
    w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
    u, v = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / w, (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / w
    u_x, v_x = (m[0, 0] - m[2, 0] * u) / w, (m[1, 0] - m[2, 0] * v) / w
    u_y, v_y = (m[0, 1] - m[2, 1] * u) / w, (m[1, 1] - m[2, 1] * v) / w
    reach = (abs(u_x) + abs(v_x)) * x + (abs(u_y) + abs(v_y)) * y
    share = (abs(m[2, 0]) * x + abs(m[2, 1]) * y) / abs(w)
    bent = reach * share / (1.0 - share) if share < 1.0 else np.inf
    return Linear(u - u_x * x - u_y * y, v - v_x * x - v_y * y, u_x, v_x, u_y, v_y, bent)


@inlined
def _replaces(f: Linear, rows: int, columns: int, width: int, height: int) -> bool:
    """Return whether a linear function may replace its homography, and a frame has all neighbours and a spare row."""
    if not (f.bent < BENT and abs(f.u_x - 1) < _STEEPEST and abs(f.v_x) < _STEEPEST):
        return False
    for corner in range(4):
        x, y = (corner % 2) * (width - 1), (corner // 2) * (height - 1)
        u, v = f.u + x * f.u_x + y * f.u_y, f.v + x * f.v_x + y * f.v_y
        # The spare row: a block may read some pixels beyond the end of a line.
        if not (_CLEAR_PX <= u < columns - 1 - _CLEAR_PX and _CLEAR_PX <= v < rows - 2 - _CLEAR_PX):
            return False
    return True


@inlined
def is_almost_shift(m: Floats, width: int, height: int) -> bool:
    """Return whether a homography is close enough to a shift along each line of a picture of this size."""
    for corner in range(4):
        x, y = (corner % 2) * width, (corner // 2) * height
        w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
        if w <= 0 or abs(m[2, 0]) * _LEAST_RUN_PX**2 >= BENT * w:
            return False
        u, v = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / w, (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / w
        right, down = (m[0, 0] - m[2, 0] * u) / w, (m[1, 0] - m[2, 0] * v) / w
        if abs(right - 1) >= _STEEPEST or abs(down) >= _STEEPEST:
            return False
    return True


@inlined
def longest_run(m: Floats) -> int:
    """Return the largest number of pixels over which a homography is linear."""
    return int(min(np.sqrt(BENT * abs(m[2, 2]) / (abs(m[2, 0]) + 1e-30)), _RUN_PX))


@inlined
def _steps(at: float, step: float) -> int:
    """Return the number of steps from a position in [0, 1) for which the position stays there; at least 1."""
    if step > 1e-9:
        return int(min(np.ceil((1.0 - at) / step), 1e6))
    if step < -1e-9:
        return int(min(np.floor(at / -step) + 1.0, 1e6))
    return 1000000


@inlined
def _run_at(position: tuple[float, float, float, float], most: int) -> Run:
    """Return the run that begins at a position in the frame; see `_position`."""
    u, v, du, dv = position
    left, top = int(np.floor(u)), int(np.floor(v))
    right, down, count = u - left, v - top, most
    # The run ends where a neighbour changes. Short lines rarely need divisions.
    last_right, last_down = right + du * (most - 1), down + dv * (most - 1)
    if not (0.0 <= last_right < 1.0 and 0.0 <= last_down < 1.0):
        count = min(most, _steps(right, du), _steps(down, dv))
    return Run(left, top, right, down, du, dv, count)


@inlined
def _position(m: Floats, x: int, y: int) -> tuple[float, float, float, float]:
    """Return the position in the frame of a pixel, and its change per pixel along x, less 1 to the right."""
    scale = 1.0 / (m[2, 0] * x + m[2, 1] * y + m[2, 2])
    u = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) * scale
    v = (m[1, 0] * x + m[1, 1] * y + m[1, 2]) * scale
    return u, v, (m[0, 0] - m[2, 0] * u) * scale - 1.0, (m[1, 0] - m[2, 0] * v) * scale


@inlined
def run_from(m: Floats, x: int, y: int, most: int) -> Run:
    """Return the run that begins at a pixel, with at most this number of pixels."""
    return _run_at(_position(m, x, y), most)


class _Place(NamedTuple):
    """Where the values of a run lie in the frame and in the output, and their weights there."""

    first: np.uint64
    below: np.uint64
    beside: np.uint64
    at: np.uint64
    right: np.float32
    down: np.float32
    step_right: np.float32
    step_down: np.float32
    pixels_per_value: np.float32


@inlined
def _blend(source: NDArray[Any], p: _Place, n: int, out: NDArray[Any]) -> None:
    """Write value n of a run, rounded."""
    # Unsigned numbers, because the compiler uses vector registers only if no index can be negative.
    k = np.uint64(n)
    # All values of a pixel have its weights. The half keeps the quotient clear of whole numbers.
    steps = np.floor((np.float32(np.int32(n)) + np.float32(0.5)) * p.pixels_per_value)
    first, below = p.first + k, p.first + p.below + k
    a, b = np.float32(source[first]), np.float32(source[first + p.beside])
    c, d = np.float32(source[below]), np.float32(source[below + p.beside])
    s, t = p.right + p.step_right * steps, p.down + p.step_down * steps
    upper, lower = a + s * (b - a), c + s * (d - c)
    out[p.at + k] = np.int32(upper + t * (lower - upper) + np.float32(0.5))


@inlined
def _interpolate(
    source: NDArray[Any], pitch: int, channels: int, run: Run, ends: tuple[int, int], out: NDArray[Any], start: int
) -> None:
    """Write pixels of a run from `out[start]` on; all their neighbours lie in the frame.

    `ends` are the number of pixels, and up to which number further values may be written, which are of no use.
    """
    place = _Place(
        np.uint64(run.top * pitch + run.left * channels), np.uint64(pitch), np.uint64(channels), np.uint64(start),
        np.float32(run.right), np.float32(run.down),
        np.float32(run.step_right), np.float32(run.step_down), np.float32(1.0 / channels),
    )  # fmt: skip
    values, room = ends[0] * channels, ends[1] * channels
    if room < _BLOCK:
        for n in range(values):
            _blend(source, place, n, out)
        return
    for begin in range(0, values, _BLOCK):
        # The last block begins earlier and computes some values again, rather than exceed the room.
        block = min(begin, room - _BLOCK)
        for n in range(_BLOCK):
            _blend(source, place, block + n, out)


@inlined
def _shows(rows: int, columns: int, m: Floats, width: int, height: int) -> bool:
    """Return whether a frame of this size has all neighbours of all pixels of a picture."""
    for corner in range(4):
        x, y = (corner % 2) * (width - 1), (corner // 2) * (height - 1)
        w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
        u, v = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / w, (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / w
        if not (0 <= u < columns - 1 and 0 <= v < rows - 1):
            return False
    return True


@inlined
def _read_ahead(frame: NDArray[Any], f: Linear, channels: int, width: int, lines: tuple[int, int]) -> int:
    """Read a value of each cache line that lines of a picture need; return the sum, so that it is not left out.

    A picture's lines are far apart in the frame. One after the other, each would wait for memory; here none waits for
    another, which takes a quarter of the time of small pictures.
    """
    total = 0
    for y in range(lines[0], lines[1]):
        row, first = int(f.v + y * f.v_y), int(f.u + y * f.u_y) * channels
        end = min(first + (width + 1) * channels, frame.shape[1])
        for x in range(first, end, _CACHE_LINE):
            total += frame[row, x]
        total += frame[row, end - 1]
    return int(total)


@inlined
def _resample(
    frame: NDArray[Any],
    m: Floats,
    f: Linear,
    is_linear: bool,
    channels: int,
    out: NDArray[Any],
    place: NDArray[np.int_],
) -> None:
    """Resample a frame run by run by a homography, or by the linear function that replaces it (`_replaces`)."""
    rows, columns, width = frame.shape[0], frame.shape[1] // channels, place[2]
    longest, source = width if is_linear else longest_run(m), frame.reshape(-1)
    for y in range(place[3]):
        x = 0
        if is_linear and y % _BAND_PX == 0:
            # The value is replaced by that of the pixel below.
            lines = y, min(y + _BAND_PX, place[3])
            out[(place[0] + y * place[1]) * channels] = _read_ahead(frame, f, channels, width, lines) & 1
        while x < width:
            start, room = (place[0] + y * place[1] + x) * channels, width - x
            if is_linear:
                position = f.u + x * f.u_x + y * f.u_y, f.v + x * f.v_x + y * f.v_y, f.u_x - 1.0, f.v_x
            else:
                position = _position(m, x, y)
            run = _run_at(position, min(longest, room))
            count = run.length
            if run.top < 0 or run.top + 1 >= rows or run.left + count <= 0 or run.left + 1 >= columns:
                for s in range(start, start + count * channels):
                    out[s] = 0
            elif run.left < 0:
                count = 1
                for s in range(start, start + channels):
                    out[s] = 0
            else:
                # At the end of the frame, one pixel at a time.
                count = count if run.left + count < columns else 1
                # What a block writes beyond a line is written again, where the next line follows without a gap.
                rest = (place[3] - y) * width - x if place[1] == width else room
                ends = count, rest if is_linear else count
                _interpolate(source, frame.shape[1], channels, run, ends, out, start)
            x += count


@compiled
def shift(
    frame: NDArray[Any],
    matrices: Floats,
    channels: int,
    out: NDArray[Any],
    places: NDArray[np.int_],
    whole: bool,
) -> NDArray[np.bool_]:
    """Resample a frame bilinearly and write the values, rounded, to k rectangles; 0 if a neighbour is beside the frame.

    Return which were done (k,). A rectangle is not if its homography is not close enough to a shift.

    Args:
        frame: (rows, columns · channels) pixels, read-only.
        matrices: (k, 3, 3) homographies from pixels of the rectangles to those of the frame.
        channels: number of values of a pixel.
        out: (n,) output.
        places: (k, 4) number of the rectangle's first pixel in `out`, pixels from one line to the next, width, height.
        whole: do nothing unless the frame has all neighbours of all pixels of a rectangle.
    """
    rows, columns = frame.shape[0], frame.shape[1] // channels
    done = np.ones(len(matrices), np.bool_)
    for k in range(len(matrices)):
        m, width, height = matrices[k], places[k, 2], places[k, 3]
        linear = linear_part(m, width, height)
        is_linear = _replaces(linear, rows, columns, width, height)
        done[k] = is_linear or (
            is_almost_shift(m, width, height) and (not whole or _shows(rows, columns, m, width, height))
        )
        if done[k]:
            _resample(frame, m, linear, is_linear, channels, out, places[k])
    return done
