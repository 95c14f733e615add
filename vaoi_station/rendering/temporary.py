"""Temporary images (paper, section 3.4): one upright picture of a component, resampled from one frame (bilinear)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.geometry.homographies import of_part, to_part
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.rendering.views import Tile, View, ViewTable

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
    return _resampled(frame, (view.width, view.height), view.matrix, view.tiles)


def render_all(views: ViewTable, frame: Callable[[int, int], NDArray[Any] | None]) -> list[NDArray[Any] | None]:
    """Render the temporary images of many views, each as `render` does, in the order of the table.

    `frame` returns the pixels of a camera and row, and is called once for each; images of a missing frame are None.
    """
    made: list[NDArray[Any] | None] = [None] * len(views.key)
    sizes, keys = views.crops.size.astype(int)[views.component].tolist(), list(map(tuple, views.key.tolist()))
    of_frame: tuple[int, int] | None = None
    pixels: NDArray[Any] | None = None
    for n in np.lexsort(views.key.T).tolist():
        if keys[n] != of_frame:
            of_frame, pixels = keys[n], frame(*keys[n])
        if pixels is not None:
            made[n] = _resampled(pixels, sizes[n], views.matrix[n], views.tiles.get(n, ()))
    return made


def _resampled(frame: NDArray[Any], size: tuple[int, int], matrix: Floats, tiles: tuple[Tile, ...]) -> NDArray[Any]:
    """Resample a frame into a picture of this width and height by its matrix, or tile by tile if it has tiles."""
    picture = np.empty((size[1], size[0], *frame.shape[2:]), dtype=frame.dtype)
    for x0, y0, x1, y1, own in tiles or ((0, 0, *size, matrix),):
        # OpenCV writes into the picture itself. WARP_INVERSE_MAP: a matrix maps the picture to the frame already.
        if frame.dtype != np.uint16:
            cv2.warpPerspective(frame, own, (x1 - x0, y1 - y0), dst=picture[y0:y1, x0:x1], flags=_FLAGS)
            continue
        for top in range(y0, y1, _EXACT_PX):
            for left in range(x0, x1, _EXACT_PX):
                part = picture[top : min(top + _EXACT_PX, y1), left : min(left + _EXACT_PX, x1)]
                _warp_exactly(frame, of_part(own, left - x0, top - y0), part)
    return picture


def _warp_exactly(frame: NDArray[Any], matrix: Floats, out: NDArray[Any]) -> None:
    """Resample from the part of the frame that a small picture shows, with its own origin."""
    (h, w), limits = out.shape[:2], np.array(frame.shape[1::-1])
    raw = apply(matrix, np.array([(0, 0), (w - 1, 0), (w - 1, h - 1), (0, h - 1)], np.float64))
    low = np.clip(np.floor(raw.min(0)) - 1, 0, limits - 1).astype(int)
    high = np.clip(np.ceil(raw.max(0)) + 2, low + 1, limits).astype(int)
    part = frame[low[1] : high[1], low[0] : high[0]]
    cv2.warpPerspective(part, to_part(matrix, *low.tolist()), (w, h), dst=out, flags=_FLAGS)


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
