"""The pictures of one component: the same footprint in all frames that show it, on one plane and blurred alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.heights.part_grids import Frames, PartGrid, Places
from vaoi_station.heights.resampling import Cuts, Ints, lay_pictures, place_cuts, surface_boxes


class Pictures(NamedTuple):
    """What a component's frames have in common, for k frames."""

    grid: PartGrid
    """The grid; `keys`, `feet_px` and `distance_mm` are those of the k frames."""
    group: Ints
    """(k,) number of the light."""
    spread: float
    """Largest displacement between two pictures, px of the grid per mm of height."""
    images: tuple[NDArray[Any], ...]


def collect_pictures(grid: PartGrid, frames: Frames, light: Callable[[int], int]) -> Pictures | None:
    """Collect the frames that show a grid; None if there are fewer than two.

    `light` gives the number of the light of a row.
    """
    keys = [(camera, row) for camera, row in grid.keys.tolist()]
    images = [frames.get(key, grid.level) for key in keys]
    there = [n for n, image in enumerate(images) if image is not None]
    if len(there) < 2:
        return None
    if len(there) < len(keys):
        grid = grid._replace(keys=grid.keys[there], feet_px=grid.feet_px[there], distance_mm=grid.distance_mm[there])
    feet = [complex(x, y) for x, y in grid.feet_px.tolist()]
    spread = max(abs(a - b) for a in feet for b in feet) / (sum(grid.distance_mm.tolist()) / len(feet))
    if spread <= 0:
        return None
    group = np.array([light(keys[n][1]) for n in there])
    return Pictures(grid, group, spread, tuple(image for image in images if image is not None))


class CutPictures(NamedTuple):
    """The parts of the frames that a range of heights needs."""

    cuts: Cuts
    boxes: Ints
    """(k, 4) what the heights need of each picture on the board's surface, as a box of the grid."""


def cut_pictures(places: Places, pictures: Pictures, lowest_mm: float, highest_mm: float) -> CutPictures:
    """Cut out of the frames what shows the grid at all heights between two over the board's surface."""
    grid, images = pictures.grid, pictures.images
    boxes = surface_boxes(grid.width, grid.height, grid.feet_px, grid.distance_mm, (lowest_mm, highest_mm))
    place, size = np.empty((len(images), 5), np.int64), np.array([image.shape[::-1] for image in images])
    way = places.row_from_grid(grid)
    cuts = Cuts(
        np.empty(0, np.float32), place, np.ascontiguousarray(grid.keys[:, 0]), way, grid.surface_mm, 0.5**grid.level
    )
    grey = np.empty(place_cuts(places.cameras, cuts, boxes, size), np.float32)
    for (first, x, y, columns, rows), image in zip(place.tolist(), images, strict=True):
        part = image[y : y + rows, x : x + columns]
        grey[first : first + part.size].reshape(part.shape)[...] = part
    return CutPictures(cuts._replace(grey=grey), boxes)


def surface_stack(places: Places, pictures: Pictures, cut: CutPictures) -> tuple[NDArray[np.float32], int]:
    """Return the pictures (k, h, w) on the board's surface where heights need them, else NaN; and their margin."""
    grid, boxes = pictures.grid, cut.boxes
    margin = max(0, -int(boxes[:, :2].min()), int((boxes[:, 2:] - (grid.width, grid.height)).max()))
    return _stack(places, grid, cut.cuts, boxes, margin, 0.0), margin


def picture_stack(
    places: Places, pictures: Pictures, cut: CutPictures, margin: int, height_mm: float
) -> NDArray[np.float32]:
    """Return the pictures (k, h, w) of a grid on the plane at a height above the board, with a margin."""
    grid = pictures.grid
    boxes = np.array([(-margin, -margin, grid.width + margin, grid.height + margin)] * len(pictures.images))
    return _stack(places, grid, cut.cuts, boxes, margin, height_mm)


def _stack(
    places: Places, grid: PartGrid, cuts: Cuts, boxes: Ints, margin: int, height_mm: float
) -> NDArray[np.float32]:
    stack = np.empty((len(boxes), grid.height + 2 * margin, grid.width + 2 * margin), np.float32)
    lay_pictures(places.cameras, cuts, boxes, margin, height_mm, stack)
    return stack
