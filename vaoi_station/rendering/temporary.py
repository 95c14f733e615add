"""Temporary images (paper, section 3.4): one upright picture of a component, resampled from one frame (bilinear)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.geometry.homographies import through
from vaoi_station.geometry.transforms import Floats
from vaoi_station.rendering.views import Tile, View, ViewTable, rectangles

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
    if view.tiles:
        _fill(picture, view.tiles, frame)
    elif _shift(view.matrix[None], _whole(view.width, view.height), frame, picture):
        _warp(frame, view.matrix, picture)
    return picture


def render_all(views: ViewTable, frame: Callable[[int, int], NDArray[Any] | None]) -> list[NDArray[Any] | None]:
    """Render the temporary images of many views, each as `render` does, in the order of the table.

    `frame` returns the pixels of a camera and row; images of a missing frame are None. The images of one frame are
    parts of one array.
    """
    order, begins = views.by_frame()
    size = views.crops.size.astype(np.int_)[views.component[order]]
    area, numbers, matrices, tiles = size.prod(1), order.tolist(), views.matrix[order], views.tiles
    ends = area.cumsum()
    places = np.empty((len(numbers), 4), np.int_)
    places[:, 0], places[:, 1], places[:, 2:] = ends - area, size[:, 0], size
    if tiles:
        # A distorted picture is not that of its matrix, but made of its tiles.
        places[np.isin(order, list(tiles)), 2:] = 0
    made: list[NDArray[Any] | None] = []
    for begin, end in pairwise([*begins, len(numbers)]):
        mine = slice(begin, end)
        if (pixels := frame(*views.key[numbers[begin]].tolist())) is None:
            made += [None] * (end - begin)
            continue
        origin, channels, kind = int(ends[begin] - area[begin]), pixels.shape[2:], pixels.dtype
        places[mine, 0] -= origin
        out = np.empty((int(ends[end - 1]) - origin, *channels), dtype=kind)
        left = _shift(matrices[mine], places[mine], pixels, out)
        starts = (places[mine, 0] * (kind.itemsize * math.prod(channels))).tolist()
        # A slice of `out` and its shape would be two objects for each picture.
        own: list[NDArray[Any]] = [
            np.ndarray((height, width, *channels), kind, out, start)
            for start, (width, height) in zip(starts, size[mine].tolist(), strict=True)
        ]
        for k in left:
            if numbers[begin + k] not in tiles:
                _warp(pixels, matrices[begin + k], own[k])
        if tiles:
            for n, picture in zip(numbers[mine], own, strict=True):
                _fill(picture, tiles.get(n, ()), pixels)
        made += own
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    return [made[k] for k in back.tolist()]


def subtract(image: NDArray[Any], other: NDArray[Any], ratio: float = 1.0) -> NDArray[Any]:
    """Return the difference of two images under different lights, in the pixel type of the image.

    It is middle grey + (image − ratio · other) / 2. Where both are equally bright, it is 128 (8 bit) or 32768 (16 bit);
    one level of it is two of the image.

    Args:
        image: (h, w) or (h, w, 3), 8 or 16 bit.
        other: the image that is subtracted, of the same shape and type.
        ratio: factor on its grey levels, that makes its exposure that of the first.
    """
    if image.shape != other.shape or image.dtype != other.dtype:
        raise InputError(
            f"images of {image.shape} {image.dtype} and {other.shape} {other.dtype} cannot be subtracted.",
            action="Use cameras of one pixel format.",
        )
    most = int(np.iinfo(image.dtype).max)
    value = (most + 1) / 2 + (image.astype(np.float32) - np.float32(ratio) * other.astype(np.float32)) / 2
    return np.asarray(np.clip(np.rint(value), 0, most), dtype=image.dtype)


@lru_cache(maxsize=256)
def _whole(width: int, height: int) -> NDArray[np.int_]:
    """Return the place of a whole picture for `_shift`. A board has many components of few sizes."""
    return np.array([[0, width, width, height]])


def _fill(picture: NDArray[Any], parts: Sequence[Tile], frame: NDArray[Any]) -> None:
    """Resample a frame into the tiles of a picture, if it has any."""
    if not parts:
        return
    width, matrices = picture.shape[1], np.array([part[4] for part in parts])
    places = np.array([(y0 * width + x0, width, x1 - x0, y1 - y0) for x0, y0, x1, y1, _ in parts])
    for n in _shift(matrices, places, frame, picture):
        x0, y0, x1, y1, matrix = parts[n]
        # OpenCV writes into the picture itself: a copy of every tile would take a fifth of the time.
        _warp(frame, matrix, picture[y0:y1, x0:x1])


def _shift(matrices: Floats, places: NDArray[np.int_], frame: NDArray[Any], out: NDArray[Any]) -> list[int]:
    """Resample the rectangles of a picture that lie almost upright in the frame; return the numbers of the others."""
    # In 16 bit, a run of shifted pixels would deviate by more than a grey level from its homography.
    lines = _lines(frame) if frame.dtype == np.uint8 else None
    if lines is None:
        return list(range(len(places)))
    done = _compiled()(lines, matrices, math.prod(frame.shape[2:]), out.reshape(-1), places, True)
    return [n for n, is_done in enumerate(done.tolist()) if not is_done]


def _lines(frame: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Return a frame as read-only lines (rows, columns · channels); None if its pixels have gaps in memory."""
    if not frame.flags.c_contiguous:
        return None
    lines = frame.reshape(len(frame), -1)
    # Numba compiles separate versions for writeable and read-only arrays, so all frames are passed as read-only.
    lines.flags.writeable = False
    return lines


@cache
def _compiled() -> Callable[..., NDArray[np.bool_]]:
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
