"""Bilinear resampling of frames whose pixels lie almost as those of a picture: runs of pixels are shifted.

Pictures have about the resolution of the cameras, and cameras are mounted upright to a degree or so. Along a line of
the picture, the position in the frame then advances by almost one pixel per pixel, so that the four neighbours of many
pixels in turn are four runs of values in memory. The compiler uses vector registers for them, which takes half of the
time of `cv2.warpPerspective` or less. The module is imported on first use, because Numba takes a moment to load.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats

_RUN_PX, _LEAST_RUN_PX = 256, 32
"""Largest length of a run, and the smallest that is worth it; positions are linear within a run."""
_BENT = 0.002
"""Largest deviation of a homography from a linear function within a run, px: half a grey level of 255."""
_STEEPEST = 0.04
"""Largest deviation of the steps along a line from one pixel to the right: runs would be shorter than 25 px."""


class Run(NamedTuple):
    """Pixels of one line whose neighbours in the frame are runs of values as well."""

    left: int
    """Column and row in the frame of the neighbour above and to the left of the first pixel."""
    top: int
    right: float
    """Weights of the neighbours to the right and below, at the first pixel."""
    down: float
    step_right: float
    """Change of these weights from one pixel to the next."""
    step_down: float
    length: int
    """Number of pixels."""


@inlined
def is_almost_shift(m: Floats, width: int, height: int) -> bool:
    """Return whether a homography is close enough to a shift along each line of a picture of this size."""
    for corner in range(4):
        x, y = (corner % 2) * width, (corner // 2) * height
        w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
        if w <= 0 or abs(m[2, 0]) * _LEAST_RUN_PX**2 >= _BENT * w:
            return False
        u, v = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / w, (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / w
        right, down = (m[0, 0] - m[2, 0] * u) / w, (m[1, 0] - m[2, 0] * v) / w
        if abs(right - 1) >= _STEEPEST or abs(down) >= _STEEPEST:
            return False
    return True


@inlined
def longest_run(m: Floats) -> int:
    """Return the largest number of pixels over which a homography is linear."""
    return int(min(np.sqrt(_BENT * abs(m[2, 2]) / (abs(m[2, 0]) + 1e-30)), _RUN_PX))


@inlined
def _steps(at: float, step: float) -> int:
    """Return the number of steps from a position in [0, 1) for which the position stays there; at least 1."""
    if step > 1e-9:
        return int(min(np.ceil((1.0 - at) / step), 1e6))
    if step < -1e-9:
        return int(min(np.floor(at / -step) + 1.0, 1e6))
    return 1000000


@inlined
def run_from(m: Floats, x: int, y: int, most: int) -> Run:
    """Return the run that begins at a pixel, with at most this number of pixels."""
    scale = 1.0 / (m[2, 0] * x + m[2, 1] * y + m[2, 2])
    u = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) * scale
    v = (m[1, 0] * x + m[1, 1] * y + m[1, 2]) * scale
    du, dv = (m[0, 0] - m[2, 0] * u) * scale - 1.0, (m[1, 0] - m[2, 0] * v) * scale
    left, top = int(np.floor(u)), int(np.floor(v))
    right, down, count = u - left, v - top, most
    # The run ends where a neighbour changes: positions advance by 1 + du and by dv. Short lines rarely need divisions.
    last_right, last_down = right + du * (most - 1), down + dv * (most - 1)
    if not (0.0 <= last_right < 1.0 and 0.0 <= last_down < 1.0):
        count = min(most, _steps(right, du), _steps(down, dv))
    return Run(left, top, right, down, du, dv, count)


@inlined
def _interpolate(
    source: NDArray[Any], pitch: int, channels: int, run: Run, count: int, out: NDArray[Any], start: int
) -> None:
    """Write `count` pixels of a run, rounded, from `out[start]` on; all their neighbours lie in the frame."""
    first, at = np.uint64(run.top * pitch + run.left * channels), np.uint64(start)
    below, beside = np.uint64(pitch), np.uint64(channels)
    right, down = np.float32(run.right), np.float32(run.down)
    step_right, step_down = np.float32(run.step_right / channels), np.float32(run.step_down / channels)
    # Unsigned numbers, because the compiler uses vector registers only if no index can be negative.
    for n in range(count * channels):
        k, steps = np.uint64(n), np.float32(np.int32(n))
        a, b = np.float32(source[first + k]), np.float32(source[first + k + beside])
        c, d = np.float32(source[first + below + k]), np.float32(source[first + below + k + beside])
        s, t = right + step_right * steps, down + step_down * steps
        upper, lower = a + s * (b - a), c + s * (d - c)
        out[at + k] = np.int32(upper + t * (lower - upper) + np.float32(0.5))


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


@compiled
def shift(
    frame: NDArray[Any],
    matrix: Floats,
    channels: int,
    out: NDArray[Any],
    place: tuple[int, int, int, int],
    whole: bool,
) -> bool:
    """Resample a frame bilinearly and write the values, rounded, to a rectangle; 0 if a neighbour is beside the frame.

    Return whether it was done. It is not if the homography is not close enough to a shift.

    Args:
        frame: (rows, columns · channels) pixels, read-only.
        matrix: (3, 3) homography from pixels of the rectangle to those of the frame.
        channels: number of values of a pixel.
        out: (n,) output.
        place: number of the rectangle's first value in `out`, values from one line to the next, width and height, px.
        whole: do nothing unless the frame has all neighbours of all pixels.
    """
    rows, columns = frame.shape[0], frame.shape[1] // channels
    origin, line, width, height = place
    if not is_almost_shift(matrix, width, height) or (whole and not _shows(rows, columns, matrix, width, height)):
        return False
    longest, source = longest_run(matrix), frame.reshape(-1)
    for y in range(height):
        x = 0
        while x < width:
            run = run_from(matrix, x, y, min(longest, width - x))
            start, count = origin + y * line + x * channels, run.length
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
                _interpolate(source, frame.shape[1], channels, run, count, out, start)
            x += count
    return True
