"""A map of heights over a region of the board, tile by tile."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import Floats
from vaoi_station.heights.estimates import SATURATED, STEP_PX
from vaoi_station.heights.pictures import Frames, Places, collect_pictures, cut_pictures, surface_stack
from vaoi_station.heights.refinement import NOISE_AREA, UNLIKE
from vaoi_station.heights.sweep import Sweep, sweep

_TILE_PX, _STRIDE_PX = 12, 3
_LONGEST_PX = 700
"""Longest side of the grid; larger regions get larger pixels."""
_MOST_MM = 80.0
"""Longest side of a region."""
_NEIGHBOURS = 0.5
"""Weight of the four neighbouring tiles against the tile itself."""
_MATRICES_MM = 0.02
"""Standard deviation of heights by errors of the matrices, which neighbouring tiles share."""
_WORST_MM = 0.6
"""Heights with a larger standard deviation are left out."""
_ALONE_MM = 0.5
"""Heights that differ from the median around them by more than this, and than 3 σ, are left out."""


class HeightMap(NamedTuple):
    """Heights above the board on a grid of places, and their standard deviations; NaN where they are unknown."""

    height_mm: NDArray[np.float32]
    """(h, w)."""
    sigma_mm: NDArray[np.float32]
    image_from_cad: Floats
    """(3, 3) from CAD coordinates to pixels of the map, whose centres are integers."""
    px_per_mm: float


def measure_map(
    places: Places,
    region: tuple[float, float, float, float],
    frame: Callable[[int, int], NDArray[Any] | None],
    lights: Sequence[str] = (),
    highest_mm: float = 12.0,
) -> HeightMap:
    """Measure a map of heights of a region X0, Y0, X1, Y1 in CAD coordinates.

    Raises:
        InputError: the region has no area, is off the board or too large, or fewer than two frames show it.
    """
    corners = _corners(places, region)
    grid = places.grid("map", corners, _LONGEST_PX)
    numbers = {name: n for n, name in enumerate(sorted(set(lights)))}
    frames = Frames(frame)
    pictures = None
    if grid is not None:
        pictures = collect_pictures(grid, frames, lambda row: numbers[lights[row]] if lights else 0)
    if grid is None or pictures is None:
        raise InputError(
            f"map: fewer than two frames show the region {list(region)}, or it is smaller than 6 pixels.",
            action="Choose a larger region, or one that two rows or cameras show.",
        )
    step = max(STEP_PX / pictures.spread, highest_mm / 240)
    heights = np.asarray(np.arange(-3, math.ceil(highest_mm / step) + 1) * step, np.float64)
    cut = cut_pictures(places, pictures, float(heights[0]), float(heights[-1]))
    stack, margin = surface_stack(places, pictures, cut)
    xs, ys = (np.arange(0, length - _TILE_PX + 1, _STRIDE_PX) for length in (grid.width, grid.height))
    tiles = np.array([(x, y, _TILE_PX, _TILE_PX) for y in ys for x in xs]).reshape(-1, 4)
    if not len(tiles):
        raise InputError(
            f"map: the region {list(region)} has {grid.width} × {grid.height} px, must have at least {_TILE_PX}.",
            action="Choose a larger region.",
        )
    shares = heights[:, None] / pictures.grid.distance_mm
    found = sweep(stack, margin, pictures.grid.feet_px, shares, tiles, pictures.group, SATURATED)
    mm, sigma = _most_probable(found, heights, (len(ys), len(xs)))
    first = (_TILE_PX - 1) / 2
    # pixel of the map → grid → tester → CAD
    grid_from_map = np.array([[_STRIDE_PX, 0, first], [0, _STRIDE_PX, first], [0, 0, 1.0]])
    tester_from_grid = np.vstack([grid.tester_from_grid, [0, 0, 1]])
    image_from_cad = np.linalg.inv(tester_from_grid @ grid_from_map) @ places.tester_from_cad
    return HeightMap(mm, sigma, image_from_cad, 1 / (grid.mm_per_px * _STRIDE_PX))


def draw_map(found: HeightMap) -> NDArray[np.uint8]:
    """Draw a map as a colour picture with a scale; unknown heights are black."""
    known = np.isfinite(found.height_mm)
    top = max(0.5, float(np.percentile(found.height_mm[known], 99.5)) if known.any() else 0.0)
    level = np.clip(np.nan_to_num(found.height_mm) / top * 255, 0, 255).astype(np.uint8)
    picture = cv2.applyColorMap(level, cv2.COLORMAP_VIRIDIS)
    picture[~known] = 0
    zoom = max(1, 600 // max(picture.shape[:2]))
    picture = cv2.resize(picture, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_NEAREST)
    bar = cv2.applyColorMap(np.linspace(255, 0, picture.shape[0]).astype(np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)
    legend = np.full((picture.shape[0], 110, 3), 255, np.uint8)
    legend[:, 10:30] = bar
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        y = round((1 - share) * (picture.shape[0] - 14)) + 11
        text = f"{share * top:.2f} mm"
        cv2.putText(legend, text, (34, y), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
    return np.asarray(np.hstack([picture, legend]), np.uint8)


def _corners(places: Places, region: tuple[float, float, float, float]) -> Floats:
    """Return the corners (4, 2) of a region, in the order of a footprint; raise InputError if it is not valid."""
    x0, y0, x1, y1 = region
    low, high = np.minimum((x0, y0), (x1, y1)), np.maximum((x0, y0), (x1, y1))
    board_low, board_high = places.board_type.extent()
    mm = (high - low) * places.board_type.mm_per_unit
    unit = places.board_type.unit
    if not np.isfinite(mm).all() or mm.min() <= 0:
        raise InputError.field("map", "region", list(region), f"two opposite corners X0 Y0 X1 Y1 in CAD, {unit}")
    if mm.max() > _MOST_MM:
        raise InputError.field(
            "map", "region", f"{mm[0]:.1f} × {mm[1]:.1f} mm", f"at most {_MOST_MM:g} mm wide and high"
        )
    if (high < board_low).any() or (low > board_high).any():
        extent = f"{board_low.tolist()} to {board_high.tolist()} {unit}"
        raise InputError.field("map", "region", list(region), f"on the board, which extends from {extent}")
    return np.array([low, (high[0], low[1]), high, (low[0], high[1])])


def _most_probable(
    found: Sweep, heights: Floats, shape: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the mean height of every tile and its standard deviation by the probabilities of all heights."""
    sums, freedom = found.sums, found.freedom
    shown = freedom > 0
    least = sums.min(1, initial=np.inf)
    noise = np.where(shown, least / np.maximum(freedom, 1), np.inf)
    noise = np.maximum(noise, np.median(noise[shown]) if shown.any() else 1.0)
    # Of two heights that explain a repeated pattern, the one nearer to a step of the sweep must not win alone.
    own = np.take_along_axis(found.texture, sums.argmin(1)[:, None], 1)[:, 0] / np.maximum(freedom, 1)
    noise = noise + UNLIKE * np.exp(own)
    cost = np.where(shown[:, None], (sums - least[:, None]) / (2 * noise[:, None] * NOISE_AREA), 0.0)
    cost = cost.reshape(*shape, len(heights))
    padded = np.pad(cost, ((1, 1), (1, 1), (0, 0)))
    around = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
    cost = cost + _NEIGHBOURS * around
    chance = np.exp(cost.min(2, keepdims=True) - cost)
    chance /= chance.sum(2, keepdims=True)
    mm = chance @ heights
    sigma = np.sqrt(chance @ heights**2 - mm**2 + _MATRICES_MM**2)
    lost = ~shown.reshape(shape) | (sigma > _WORST_MM)
    # Beside a wall, a tile shows places that the other frames do not: it may fit by chance, at any height.
    lost |= np.abs(mm - _median_around(np.where(lost, np.nan, mm))) > np.maximum(3 * sigma, _ALONE_MM)
    return np.where(lost, np.nan, mm).astype(np.float32), np.where(lost, np.nan, sigma).astype(np.float32)


def _median_around(mm: Floats) -> Floats:
    """Return the median of the known heights around each place, among 7 × 7."""
    padded = np.pad(mm, 3, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (7, 7)).reshape(*mm.shape, 49)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of windows without any known height
        return np.asarray(np.nanmedian(windows, axis=2))
