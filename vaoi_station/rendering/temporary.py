"""Temporary images (paper, section 3.4): one upright picture of a component, resampled from one frame (bilinear)."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.rendering.tiles import rectangles, through
from vaoi_station.rendering.view import View

_FLAGS = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
_EXACT_PX = 64
"""Longest side of the parts in which frames of 16 bit are resampled.

OpenCV computes places in single precision. At 2000 px from the origin, their error is 0.0001 px, which moves an edge of
65535 grey levels by more than one. In a part with its own origin, the error is 30 times as small."""


def render(view: View, frame: NDArray[Any]) -> NDArray[Any]:
    """Resample a frame into one temporary image, (height, width) or (height, width, channels).

    The image has the pixel type of the frame: every pixel is the bilinear interpolation at the place that equation 22
    states, within one grey level. Places outside the frame are black; within one pixel of its border the image fades to
    black. If lens distortion matters in this view, the image is made in tiles, with an error of at most 0.004 px for
    the lenses of such an array.
    """
    picture = np.empty((view.height, view.width, *frame.shape[2:]), dtype=frame.dtype)
    # In 16 bit, a run of shifted pixels would deviate by more than a grey level from its homography.
    lines = _lines(frame) if frame.dtype == np.uint8 else None
    for x0, y0, x1, y1, matrix in view.tiles or ((0, 0, view.width, view.height, view.matrix),):
        if lines is not None:
            channels = lines.shape[1] // frame.shape[1]
            across = view.width * channels
            place = y0 * across + x0 * channels, across, x1 - x0, y1 - y0
            if _shift()(lines, matrix, channels, picture.reshape(-1), place, True):
                continue
        # OpenCV writes into the picture itself: a copy of every tile would take a fifth of the time.
        _warp(frame, matrix, picture[y0:y1, x0:x1])
    return picture


def _lines(frame: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Return a frame as read-only lines (rows, columns · channels); None if its pixels have gaps in memory."""
    if not frame.flags.c_contiguous:
        return None
    lines = frame.reshape(len(frame), -1)
    # Numba compiles separate versions for writeable and read-only arrays, so all frames are passed as read-only.
    lines.flags.writeable = False
    return lines


@cache
def _shift() -> Callable[..., bool]:
    """Return the compiled function. It is imported on first use, because Numba takes a moment to load."""
    from vaoi_station.geometry.shifting import shift

    return shift


def _warp(frame: NDArray[Any], matrix: Floats, out: NDArray[Any]) -> None:
    """Resample a frame by a matrix from pixels of the picture `out` to pixels of the frame."""
    if frame.dtype == np.uint16:
        _warp_in_parts(frame, matrix, out)
    else:
        # WARP_INVERSE_MAP: `matrix` maps the picture to the frame already, so OpenCV must not invert it.
        cv2.warpPerspective(frame, matrix, out.shape[1::-1], dst=out, flags=_FLAGS)


def _warp_in_parts(frame: NDArray[Any], matrix: Floats, picture: NDArray[Any]) -> None:
    (height, width), limits = picture.shape[:2], np.array(frame.shape[1::-1])
    boxes = np.array(rectangles(width, height, -(-width // _EXACT_PX), -(-height // _EXACT_PX)))
    x0, y0, x1, y1 = boxes.T
    corners = np.stack([x0, y0, x1 - 1, y0, x1 - 1, y1 - 1, x0, y1 - 1], -1).reshape(-1, 4, 2).astype(np.float64)
    raw = through(np.broadcast_to(matrix, (len(boxes), 3, 3)), corners)
    # The part of the frame that a part of the picture shows, with one pixel around it for the interpolation.
    low = np.clip(np.floor(raw.min(1)) - 1, 0, limits - 1).astype(int)
    high = np.clip(np.ceil(raw.max(1)) + 2, low + 1, limits).astype(int)
    shift, back = np.tile(np.eye(3), (len(boxes), 1, 1)), np.tile(np.eye(3), (len(boxes), 1, 1))
    shift[:, :2, 2], back[:, :2, 2] = boxes[:, :2], -low
    own = back @ matrix @ shift
    for (a, b, c, d), (left, top), (right, bottom), m in zip(
        boxes.tolist(), low.tolist(), high.tolist(), own, strict=True
    ):
        part = frame[top:bottom, left:right]
        cv2.warpPerspective(part, m, (c - a, d - b), dst=picture[b:d, a:c], flags=_FLAGS)
