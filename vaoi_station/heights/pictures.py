"""The pictures of one component: the same footprint in all frames that show it, on one plane and blurred alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.heights.part_grids import Frames, PartGrid, Places

_BLUR_PX = 1.1
"""Blur of the pictures before they are compared.

Interpolation between pixels removes noise, most of all half-way between two pixels. Without blur, heights at which the
pictures lie half-way would seem to fit best."""
_BLUR_REACH_PX = 5
"""Distance beyond which a pixel has no influence through the blur."""


class Pictures(NamedTuple):
    """What a component's frames have in common, for k frames."""

    grid: PartGrid
    feet_px: Floats
    """(k, 2)."""
    distance_mm: Floats
    """(k,)."""
    group: NDArray[np.int_]
    """(k,) number of the light."""
    spread: float
    """Largest displacement between two pictures, px of the grid per mm of height."""
    images: tuple[NDArray[Any], ...]


def blurred(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a picture with the blur that comparisons need."""
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), _BLUR_PX), np.float32)


def collect_pictures(grid: PartGrid, frames: Frames, light: Callable[[int], int]) -> Pictures | None:
    """Collect the frames that show a grid; None if there are fewer than two.

    `light` gives the number of the light of a row.
    """
    images = [(view, frames.get(view.key, grid.level)) for view in grid.views]
    there = [(view, image) for view, image in images if image is not None]
    if len(there) < 2:
        return None
    views = tuple(view for view, _ in there)
    feet = np.array([view.foot_px for view in views])
    distance = np.array([view.distance_mm for view in views])
    group = np.array([light(view.key[1]) for view in views])
    spread = float(np.hypot(*(feet[:, None] - feet[None]).reshape(-1, 2).T).max() / distance.mean())
    if spread <= 0:
        return None
    return Pictures(grid._replace(views=views), feet, distance, group, spread, tuple(i for _, i in there))


def picture_stack(places: Places, pictures: Pictures, margin: int, height_mm: float) -> NDArray[np.float32]:
    """Return the blurred pictures (k, h, w) of a grid on the plane at a height above the board, with a margin."""
    stack = places.rectified(pictures.grid, pictures.images, margin, height_mm)
    for picture in stack:
        cv2.GaussianBlur(picture, (0, 0), _BLUR_PX, dst=picture)
    return stack


def sweep_stack(places: Places, pictures: Pictures, margin: int, ends: Floats) -> NDArray[np.float32]:
    """Return the pictures (k, h, w) on the board's surface, with a margin, where the sweep reads them; else NaN.

    `ends` (2, k) are the lowest and the highest height as shares of the cameras' heights.
    """
    grid = pictures.grid
    size = np.array([grid.width, grid.height])
    corners = np.array([[0.0, 0.0], size - 1.0])
    places_px = (corners[:, None, None] - ends[..., None] * pictures.feet_px) / (1 - ends[..., None])
    low = np.floor(places_px.min((0, 1))).astype(np.int_) - _BLUR_REACH_PX
    high = np.ceil(places_px.max((0, 1))).astype(np.int_) + 2 + _BLUR_REACH_PX
    low, high = np.maximum(low, -margin), np.minimum(high, size + margin)
    stack = np.full((len(grid.views), grid.height + 2 * margin, grid.width + 2 * margin), np.nan, np.float32)
    for k, (view, image) in enumerate(zip(grid.views, pictures.images, strict=True)):
        (x0, y0), (x1, y1) = low[k].tolist(), high[k].tolist()
        part = blurred(places.rectified_box(grid, view, image, (x0, y0, x1, y1)))
        stack[k, y0 + margin : y1 + margin, x0 + margin : x1 + margin] = part
    return stack
