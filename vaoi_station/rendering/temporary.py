"""Temporary images (paper, section 3.4): one upright picture of a component, resampled from one frame (bilinear)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.geometry.resampling import resampled, resampled_in_tiles
from vaoi_station.photometry import WhiteBalance
from vaoi_station.rendering.views import Tile, View, ViewTable


def render(view: View, frame: NDArray[Any], balance: WhiteBalance | None = None) -> NDArray[Any]:
    """Resample a frame into one temporary image, (height, width) or (height, width, channels).

    The image has the pixel type of the frame: every pixel is the bilinear interpolation at the place that equation 22
    states, within one grey level. Places outside the frame are black; within one pixel of its border the image fades to
    black. If lens distortion matters in this view, the image is made in tiles, with an error of at most 0.004 px for
    the lenses of such an array. With `balance`, its colours are balanced.
    """
    if view.tiles:
        image = _of_tiles(frame, view.tiles)
    else:
        image = resampled(frame, view.matrix[None], np.array([(view.width, view.height)]))[0]
    return image if balance is None else balance.applied(image)


def render_all(views: ViewTable, frame: Callable[[int, int], NDArray[Any] | None]) -> list[NDArray[Any] | None]:
    """Render the temporary images of many views, each as `render` does, in the order of the table.

    `frame` returns the pixels of a camera and row, and is called once for each; images of a missing frame are None. The
    images of one frame are parts of one array.
    """
    made: list[NDArray[Any] | None] = [None] * len(views.key)
    order, tiled = np.lexsort(views.key.T), np.isin(np.arange(len(views.key)), list(views.tiles))
    keys, sizes = views.key[order], views.crops.size.astype(int)[views.component]
    # Where another frame begins.
    ends = [*np.flatnonzero((np.diff(keys, axis=0, prepend=-1) != 0).any(1)).tolist(), len(order)]
    for begin, end in pairwise(ends):
        pixels, mine = frame(*keys[begin].tolist()), order[begin:end]
        if pixels is None:
            continue
        straight = mine[~tiled[mine]]
        images = resampled(pixels, views.matrix[straight], sizes[straight]) if len(straight) else []
        for n, image in zip(straight.tolist(), images, strict=True):
            made[n] = image
        for n in mine[tiled[mine]].tolist():
            made[n] = _of_tiles(pixels, views.tiles[n])
    return made


def _of_tiles(frame: NDArray[Any], tiles: Sequence[Tile]) -> NDArray[Any]:
    matrices = np.array([tile.matrix for tile in tiles])
    return resampled_in_tiles(frame, matrices, np.array([tile[:4] for tile in tiles]))


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
