"""The inner loop that resamples frames whose pixels lie almost as those of the mosaic: it shifts runs of pixels.

A mosaic has the resolution of the cameras, and cameras are mounted upright to a degree or so. Along a line of the
mosaic, the position in the frame then advances by almost one pixel per pixel, so that the four neighbours of many
pixels in turn are four runs of values in memory. The compiler uses vector registers for them, which takes half of the
time of `cv2.warpPerspective` or less.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats

_RUN_PX, _LEAST_RUN_PX = 256, 32
"""Largest length of a run, and the smallest that is worth it; positions are linear within a run."""
_BENT = 0.005
"""Largest deviation of a homography from a linear function within a run, px."""
_STEEPEST = 0.04
"""Largest deviation of the steps along a line from one pixel to the right: runs would be shorter than 25 px."""


def is_shift(matrix: Floats, width: int, height: int) -> bool:
    """Return whether a homography is close enough to a shift along each line of a picture of this size."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    for x, y in ((0, 0), (width, 0), (0, height), (width, height)):
        w = g * x + h * y + i
        if w <= 0 or abs(g) * _LEAST_RUN_PX**2 >= _BENT * w:
            return False
        right, down = (a - g * (a * x + b * y + c) / w) / w, (d - g * (d * x + e * y + f) / w) / w
        if abs(right - 1) >= _STEEPEST or abs(down) >= _STEEPEST:
            return False
    return True


@inlined
def _steps(at: float, step: float) -> int:
    """Return the number of steps from a position in [0, 1) for which the position stays there; at least 1."""
    if step > 1e-9:
        return int(min(np.ceil((1.0 - at) / step), 1e6))
    if step < -1e-9:
        return int(min(np.floor(at / -step) + 1.0, 1e6))
    return 1000000


@compiled
def shift(
    frame: NDArray[Any], matrix: Floats, channels: int, out: NDArray[Any], place: tuple[int, int, int, int]
) -> None:
    """Resample a frame bilinearly and write the values, rounded, to a rectangle; 0 if a neighbour is beside the frame.

    Args:
        frame: (rows, columns · channels) pixels, read-only.
        matrix: (3, 3) homography from pixels of the rectangle to those of the frame; `is_shift` holds.
        channels: number of values of a pixel.
        out: (n,) output.
        place: number of the rectangle's first value in `out`, values from one line to the next, width and height, px.
    """
    rows, columns = frame.shape[0], frame.shape[1] // channels
    origin, line, width, height = place
    longest = int(min(np.sqrt(_BENT * abs(matrix[2, 2]) / (abs(matrix[2, 0]) + 1e-30)), _RUN_PX))
    source = frame.reshape(-1)
    pitch, beside = np.uint64(frame.shape[1]), np.uint64(channels)
    for y in range(height):
        x = 0
        while x < width:
            w = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
            u = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]) / w
            v = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]) / w
            du, dv = (matrix[0, 0] - matrix[2, 0] * u) / w, (matrix[1, 0] - matrix[2, 0] * v) / w
            left, top = int(np.floor(u)), int(np.floor(v))
            tx, ty = u - left, v - top
            # The run ends where a neighbour changes: positions advance by 1 + (du − 1) and by dv.
            count = min(longest, width - x)
            count = min(count, _steps(tx, du - 1.0), _steps(ty, dv))
            start = origin + y * line + x * channels
            if top < 0 or top + 1 >= rows or left + count <= 0 or left + 1 >= columns:
                for s in range(start, start + count * channels):
                    out[s] = 0
                x += count
                continue
            if left < 0 or left + count >= columns:
                # One pixel at a time at the ends of the frame.
                count = 1
            if left < 0:
                for s in range(start, start + channels):
                    out[s] = 0
                x += 1
                continue
            first, at = np.uint64(top * frame.shape[1] + left * channels), np.uint64(start)
            step_x, step_y = np.float32((du - 1.0) / channels), np.float32(dv / channels)
            # Unsigned numbers, because the compiler uses vector registers only if no index can be negative.
            for n in range(count * channels):
                k = np.uint64(n)
                a, b = np.float32(source[first + k]), np.float32(source[first + k + beside])
                c, d = np.float32(source[first + pitch + k]), np.float32(source[first + pitch + k + beside])
                right, down = np.float32(tx) + step_x * np.float32(n), np.float32(ty) + step_y * np.float32(n)
                above, below = a + right * (b - a), c + right * (d - c)
                out[at + k] = np.int32(above + down * (below - above) + np.float32(0.5))
            x += count
