"""Compiled inner loop of merging: grey levels → radiance of a part of a frame, and sums weighted by noise, in one pass.

It serves frames that are almost shifted in the picture, which is how cameras are mounted. The module is imported on
first use, because Numba takes a moment to load.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.shifting import is_almost_shift, longest_run, run_from
from vaoi_station.geometry.transforms import Floats
from vaoi_station.photometry.noise import Floats32

BLOCK_SHIFT = 7
"""Binary logarithm of the side of a block, px, over which the flat field counts as constant for the noise.

A flat field changes by a few per cent over it, and so do weights and standard deviations; the radiance does not."""
LEAST_FLAT = 0.02
"""Flat field below which a pixel sees nothing."""
SHARPENING_PX2 = 0.25
"""Second moment, px², by which frames are sharpened along each axis before they are interpolated.

Bilinear interpolation blurs by f (1 − f) at a fraction f of a pixel: 1/4 at most, 1/6 on average. Beside bright metal
this blur would add light to dark places: by several per cent over two decades of radiance.
"""
_WITHOUT_SIGMA = 2
"""Number of sums of a merge whose standard deviation is not wanted."""
_SIDE, _MIDDLE = -SHARPENING_PX2 / 2, 1 + SHARPENING_PX2
MOST_NOISE = 2 * _SIDE**2 + _MIDDLE**2
"""Factor by which sharpening multiplies the variance of noise along one axis: the sum of the squared taps."""
LESS_NOISE = 2 * MOST_NOISE - 4 * _SIDE * _MIDDLE
"""Interpolation at a fraction f of a pixel reduces this factor by `LESS_NOISE` · f (1 − f): squares of the taps of
both, convolved."""


class Source(NamedTuple):
    """A frame and what turns its grey levels into radiance. All arrays are read-only."""

    pixels: NDArray[np.uint8]
    """(h, w), or (0, 0) of a frame with 16 bit."""
    deep: NDArray[np.uint16]
    """(h, w), or (0, 0) of a frame with 8 bit: functions of either are compiled once (`by_depth`)."""
    dark: Floats32
    """Grey level of darkness (h, w), or (1, 1) for all pixels."""
    flat: Floats32
    """Flat field (h, w), or (1, 1) for all pixels."""
    to_grey: float
    """Grey levels per pixel value."""
    full: float
    """Pixel value from which on a pixel is saturated."""
    exposure: float
    """Exposure in µs times gain."""
    read_variance: float
    """Variance of a dark pixel."""
    shot_variance: float
    """Variance per grey level of signal."""


class _Lines(NamedTuple):
    """The arrays of a frame as runs of values in memory: views of arrays cost more than the loop over a short line."""

    pixels: NDArray[np.uint8]
    deep: NDArray[np.uint16]
    dark: Floats32
    flat: Floats32


def by_depth(pixels: NDArray[Any]) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
    """Return the first two fields of a `Source` for pixels (h, w) with 8 or 16 bit."""
    pixels = pixels.view()
    other = np.empty((0, 0), np.uint16 if pixels.dtype == np.uint8 else np.uint8)
    # Numba compiles separate versions for writeable and read-only arrays, so all are passed as read-only.
    pixels.flags.writeable = other.flags.writeable = False
    return (pixels, other) if pixels.dtype == np.uint8 else (other, pixels)


@inlined
def _size(source: Source) -> tuple[int, int]:
    """Return the number of rows and columns of a frame."""
    rows, columns = source.pixels.shape
    deep_rows, deep_columns = source.deep.shape
    return max(rows, deep_rows), max(columns, deep_columns)


@inlined
def _lines(source: Source) -> _Lines:
    return _Lines(source.pixels.reshape(-1), source.deep.reshape(-1), source.dark.reshape(-1), source.flat.reshape(-1))


@inlined
def _linear_line(source: Source, lines: _Lines, first: int, count: int, out: Floats32, start: int) -> None:
    """Write the radiance of pixels from number `first` on to `out[start]` and so on.

    NaN where they are saturated or the flat field is near zero.
    """
    if len(lines.deep):
        _line_of(lines.deep, source, lines, first, count, out, start)
    else:
        _line_of(lines.pixels, source, lines, first, count, out, start)


@inlined
def _line_of(
    pixels: NDArray[Any], source: Source, lines: _Lines, first: int, count: int, out: Floats32, start: int
) -> None:
    """Do what `_linear_line` does with pixels of 8 or 16 bit."""
    to_grey, scale = np.float32(source.to_grey), np.float32(1 / source.exposure)
    full, least, nothing = np.float32(source.full), np.float32(LEAST_FLAT), np.float32(np.nan)
    even, level = len(lines.flat) == 1, lines.dark[0]
    # Unsigned numbers, because the compiler uses vector registers only if no index can be negative; and one loop for
    # each case, because it does not if there is a test for every pixel.
    at, goal = np.uint64(first), np.uint64(start)
    if not even and len(lines.dark) == 1:
        for n in range(count):
            k = np.uint64(n)
            p, f = np.float32(pixels[at + k]), lines.flat[at + k]
            value = (p * to_grey - level) * scale / f
            value = value if p < full else nothing
            out[goal + k] = value if f > least else nothing
        return
    for n in range(count):
        k = np.uint64(n)
        p, f = np.float32(pixels[at + k]), lines.flat[0] if even else lines.flat[at + k]
        d = level if len(lines.dark) == 1 else lines.dark[at + k]
        value = (p * to_grey - d) * scale / f
        value = value if p < full else nothing
        out[goal + k] = value if f > least else nothing


@inlined
def _noise_factor(s: np.float32, t: np.float32) -> Any:
    """Return the variance of noise at fractions s and t of a pixel, divided by that of the frame's pixels."""
    most, less, one = np.float32(MOST_NOISE), np.float32(LESS_NOISE), np.float32(1)
    return (most - less * s * (one - s)) * (most - less * t * (one - t))


@inlined
def _weighted(value: np.float32, scale: np.float32, dark: np.float32, shot: np.float32) -> tuple[Any, Any]:
    """Return value / variance and 1 / variance of a radiance; 0 of NaN. The variance is that of pixels of a frame."""
    nothing = np.float32(0)
    seen = value == value  # noqa: PLR0124  (NaN differs from itself)
    known = value if seen else nothing
    # The weight depends so little on the pixel's own noise that dark noise gains no weight: the bias is `shot` grey
    # levels, some hundredths of one.
    one = scale * scale / (dark + shot * scale * max(known, nothing))
    one = one if seen else nothing
    return one * known, one


@compiled
def add_shifted(
    source: Source, matrix: Floats, place: tuple[int, int, int, int], groups: NDArray[np.int64], sums: Floats32
) -> bool:
    """Add a part of a picture to the sums of several merges, if its frame is almost shifted in it.

    Return whether it was done; otherwise `sums` are unchanged.

    Args:
        source: the frame.
        matrix: (3, 3) homography from pixels of the part to those of the frame.
        place: first column and row of the part in the picture, its width and height.
        groups: (g,) numbers of the merges to which it is added.
        sums: (3, n, h, w) of n merges: sums of value / variance, of 1 / variance, and of factor / variance with the
            factor of `_noise_factor`, changed in place. (2, n, h, w): without the last ones.
    """
    x0, y0, width, height = place
    if not is_almost_shift(matrix, width, height):
        return False
    side, lines, values = 1 << BLOCK_SHIFT, _lines(source), sums.reshape(-1)
    rows, columns = _size(source)
    # A block with its neighbours stays in the processor's cache. How much of the frame a block needs depends on the
    # steps from line to line as well, which differ from 1 where pixels are not square: the largest part is measured.
    wide = high = 0
    for top in range(0, height, side):
        for left in range(0, width, side):
            box = _box(matrix, left, top, min(left + side, width), min(top + side, height), columns, rows)
            wide, high = max(wide, box[2] - box[0]), max(high, box[3] - box[1])
    # One line and the two values beside it are kept in the same memory.
    radiance, sharp = np.empty(wide * high + 2, np.float32), np.empty(wide * high + 2, np.float32)
    lines_out = _Weighted(np.empty(side, np.float32), np.empty(side, np.float32), np.empty(side, np.float32))
    for top in range(0, height, side):
        for left in range(0, width, side):
            right, bottom = min(left + side, width), min(top + side, height)
            box = _box(matrix, left, top, right, bottom, columns, rows)
            if box[0] >= box[2] or box[1] >= box[3]:
                continue
            _sharpen(source, lines, box, radiance, sharp, wide)
            middle = run_from(matrix, (left + right) // 2, (top + bottom) // 2, 1)
            scale = _flat_at(source.flat, middle.left, middle.top) * np.float32(source.exposure)
            block = _Block(sharp, wide, box[0], box[1], scale)
            for y in range(top, bottom):
                _weigh_line(source, matrix, (left, right, y), block, lines_out)
                for group in groups:
                    above = (group * sums.shape[2] + y0 + y) * sums.shape[3] + x0 + left
                    total, weights = np.uint64(above), np.uint64(above + sums[0].size)
                    for n in range(right - left):
                        k = np.uint64(n)
                        values[total + k] += lines_out.value[k]
                        values[weights + k] += lines_out.weight[k]
                    if len(sums) > _WITHOUT_SIGMA:
                        noises = np.uint64(above + 2 * sums[0].size)
                        for n in range(right - left):
                            k = np.uint64(n)
                            values[noises + k] += lines_out.noise[k]
    return True


@inlined
def _box(m: Floats, left: int, top: int, right: int, bottom: int, columns: int, rows: int) -> tuple[int, int, int, int]:
    """Return the part of a frame, first column and row and those after the last, that interpolation reads."""
    low_x = low_y = 1e9
    high_x = high_y = -1e9
    for corner in range(4):
        x, y = (left, right - 1)[corner % 2], (top, bottom - 1)[corner // 2]
        w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
        u, v = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / w, (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / w
        low_x, high_x, low_y, high_y = min(low_x, u), max(high_x, u), min(low_y, v), max(high_y, v)
    # One neighbour for interpolation, and one more on each side for sharpening.
    return (
        max(int(np.floor(low_x)) - 1, 0),
        max(int(np.floor(low_y)) - 1, 0),
        min(int(np.floor(high_x)) + 3, columns),
        min(int(np.floor(high_y)) + 3, rows),
    )


@inlined
def _flat_at(flat: Floats32, x: int, y: int) -> np.float32:
    """Return the flat field at a place, or at the nearest one in the frame."""
    rows, columns = flat.shape
    return max(flat[min(max(y, 0), rows - 1), min(max(x, 0), columns - 1)], np.float32(LEAST_FLAT))


@inlined
def _sharpen(
    source: Source, lines: _Lines, box: tuple[int, int, int, int], radiance: Floats32, sharp: Floats32, pitch: int
) -> None:
    """Write the radiance of a part of a frame to `sharp`, sharpened; `radiance` is memory of the same size.

    Saturated pixels and their eight neighbours are NaN. At the ends of a frame, the outermost value is repeated. Lines
    begin every `pitch` values.
    """
    width, height = box[2] - box[0], box[3] - box[1]
    side, middle = np.float32(_SIDE), np.float32(_MIDDLE)
    _, columns = _size(source)
    for y in range(height):
        _linear_line(source, lines, (box[1] + y) * columns + box[0], width, sharp, 1)
        sharp[0], sharp[width + 1] = sharp[1], sharp[width]
        at = np.uint64(y * pitch)
        for n in range(width):
            k = np.uint64(n)
            radiance[at + k] = middle * sharp[k + np.uint64(1)] + side * (sharp[k] + sharp[k + np.uint64(2)])
    for y in range(height):
        at, above = np.uint64(y * pitch), np.uint64(max(y - 1, 0) * pitch)
        below = np.uint64(min(y + 1, height - 1) * pitch)
        for n in range(width):
            k = np.uint64(n)
            sharp[at + k] = middle * radiance[at + k] + side * (radiance[above + k] + radiance[below + k])


class _Block(NamedTuple):
    """The sharpened radiance of a part of a frame, and what it is weighted with."""

    values: Floats32
    pitch: int
    """Values from one line to the next."""
    left: int
    """First column and row of the part in the frame."""
    top: int
    scale: np.float32
    """Grey levels per unit of radiance."""


class _Weighted(NamedTuple):
    """One line of a frame, as it is added to the sums of a merge."""

    value: Floats32
    """Value / variance."""
    weight: Floats32
    """1 / variance."""
    noise: Floats32
    """Factor / variance."""


@inlined
def _weigh_line(source: Source, m: Floats, span: tuple[int, int, int], block: _Block, out: _Weighted) -> None:
    """Write one line of a picture to `out`; 0 where a neighbour is beside the frame or NaN.

    `span` is the first column, that after the last, and the line.
    """
    left, right, y = span
    rows, columns = _size(source)
    dark, shot = np.float32(source.read_variance), np.float32(source.shot_variance)
    longest, x = longest_run(m), left
    for n in range(right - left):
        out.value[n] = out.weight[n] = out.noise[n] = 0
    while x < right:
        run = run_from(m, x, y, min(longest, right - x))
        count, before = run.length, max(-run.left, 0)
        after = min(count, columns - 1 - run.left)
        if run.top >= 0 and run.top + 1 < rows and after > before:
            above = np.uint64((run.top - block.top) * block.pitch + run.left + before - block.left)
            below, at = above + np.uint64(block.pitch), np.uint64(x + before - left)
            step_right, step_down = np.float32(run.step_right), np.float32(run.step_down)
            to_right = np.float32(run.right + run.step_right * before)
            to_below = np.float32(run.down + run.step_down * before)
            for n in range(after - before):
                k, steps = np.uint64(n), np.float32(np.int32(n))
                a, b = block.values[above + k], block.values[above + k + np.uint64(1)]
                c, d = block.values[below + k], block.values[below + k + np.uint64(1)]
                s, t = to_right + step_right * steps, to_below + step_down * steps
                upper, lower = a + s * (b - a), c + s * (d - c)
                value, one = _weighted(upper + t * (lower - upper), block.scale, dark, shot)
                out.value[at + k], out.weight[at + k], out.noise[at + k] = value, one, one * _noise_factor(s, t)
        x += count


@compiled
def mean(total: Floats32, weight: Floats32, out: Floats32) -> None:
    """Write total / weight to `out`; NaN where the weight is 0. All (h, w)."""
    nothing = np.float32(np.nan)
    for y in range(out.shape[0]):
        sums, weights, line = total[y], weight[y], out[y]
        for x in range(len(line)):
            value = sums[x] / weights[x]
            line[x] = value if weights[x] > 0 else nothing
