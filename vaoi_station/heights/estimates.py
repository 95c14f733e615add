"""Estimate the height of the body of every component of a run from its frames, and compare it with the expected one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import StateError
from vaoi_station.geometry import Camera
from vaoi_station.geometry.body_extents import EXTENTS
from vaoi_station.geometry.transforms import Floats
from vaoi_station.heights.levels import compare_heights, find_levels
from vaoi_station.heights.pictures import (
    CutPictures,
    Frames,
    PartGrid,
    Pictures,
    Places,
    collect_pictures,
    cut_pictures,
    picture_stack,
    surface_stack,
)
from vaoi_station.heights.refinement import (
    NOISE_AREA,
    UNLIKE,
    BodyEquations,
    add_up,
    combine,
    normal_equations,
    tile_weights,
    weigh_tiles,
)
from vaoi_station.heights.sweep import Sweep, sweep
from vaoi_station.model import BoardType, Component, Stitch
from vaoi_station.photometry import FlatFields
from vaoi_station.pixel_formats import eight_bit_grey

HIGHEST_MM = 12.0
"""Largest height that is searched; components that are expected to be higher extend it."""
_SLENDER, _LEAST_HIGHEST_MM = 4.0, 4.0
"""Largest height as a multiple of the footprint's longest side, and the least such limit: a chip is no tower."""
_TILE_PX = (8, 12)
_INSET_PX = 3
"""Width of the footprint's border that is left out: the blur mixes what is beside a body into it."""
SATURATED = 252.0
STEP_PX = 0.2
"""Step of the sweep: largest displacement between two pictures from one height to the next."""
_MOST_STEPS = 240
_BOARD_PX = 0.12
"""A tile that fits within this displacement of the board's level fits the board."""
_BELOW_BOARD = 2.0
"""Heights below the board are less probable by this, as a logarithm: only errors of the surface make them."""
_LOWEST_NOISE = 0.15
"""Least variance of noise after the blur in frames of full size, grey levels squared."""
_SURE = 0.99
"""Least probability of a height that is given as a number; else there are intervals."""
_SEEMING = 1e-9
"""Least probability of another height with which it is compared again, with a tolerance."""
_MIDDLE = 0.5
"""Least share of the tiles in the middle of a footprint that frames show.

Where they do not, leads, pads and the board beside a body would be taken for its top."""
_NEAR_PX = 1.0
"""Largest displacement between two pictures from the most probable height that refinement overcomes."""
_ALL, _APART_PX = 0.998, 2.0
"""Probability of all intervals together; heights are one interval up to this displacement between two pictures."""
_ONE_LINE = 0.6
"""Relative standard deviation of a height from a single row or column of tiles, or from two of many.

All may lie on edges, where body, leads and board mix: SOT-23 of 1 mm at 18 px/mm were measured as 0.44 to 0.78 mm."""
_EDGE_PX = 0.08
"""Standard deviation of the displacement, px of a frame, that tiles at the edges of a body have in common.

Next to an edge they see a wall or the board as well, which move less than the top."""
_ROUNDS, _CONVERGED_PX = 5, 0.005


class Interval(NamedTuple):
    """A range of heights that explain the pictures, and the probability that the height lies in it."""

    low_mm: float
    high_mm: float
    probability: float


@dataclass(frozen=True)
class PartHeight:
    """How far a component stands above the board, as far as the frames show it."""

    height_mm: float | None
    """None if several heights are probable."""
    sigma_mm: float | None
    intervals: tuple[Interval, ...]
    """All heights that explain the pictures, ascending; none if the height is known, or if nothing can be said."""
    views: int
    """Number of frames that show it."""


class _Swept(NamedTuple):
    heights_mm: Floats
    probability: Floats
    tiles: NDArray[np.int_]
    """(t, 4) tiles on the body."""
    used: NDArray[np.bool_]
    """(t, k) pictures that show them."""
    cut: CutPictures


def measure_heights(
    board_type: BoardType,
    stitch: Stitch,
    cameras: Sequence[Camera],
    frame: Callable[[int, int], NDArray[Any] | None],
    lights: Sequence[str] = (),
) -> dict[str, PartHeight]:
    """Measure the heights of all components of a run, by address.

    `cameras` are those of the calibration with which it was stitched. `lights` has the name of the light of every row,
    or is empty; only rows of one light are compared.

    Raises:
        StateError: the run has no CAD mapping, or the calibration no working distance.
    """
    places, frames = open_places(board_type, stitch, cameras), Frames(frame)
    parts = {c.address: measure_part(places, frames, c, lights) for c in board_type.components}
    return combine_parts(parts, stitch)


class PartMeasure(NamedTuple):
    """What the frames show of one component by itself: the first step, of which `combine_parts` makes its height."""

    views: int
    body: BodyEquations | None
    """None if no height is probable enough."""
    intervals: tuple[Interval, ...]
    """As in `PartHeight`; none with a body."""


def measure_part(places: Places, frames: Frames, component: Component, lights: Sequence[str]) -> PartMeasure:
    """Measure one component. `lights` has the name of the light of every row; it is empty if all rows have one."""
    grid = places.grid(component.address, places.board_type.footprint(component))
    if grid is None:
        return PartMeasure(0, None, ())
    numbers = {name: n for n, name in enumerate(sorted(set(lights)))}
    pictures = collect_pictures(grid, frames, lambda row: numbers[lights[row]] if lights else 0)
    if pictures is None:
        return PartMeasure(_count(grid, frames), None, ())
    views = len(pictures.images)
    found = _sweep(places, pictures, _highest_mm(grid, component.body_height, places.board_type))
    if found is None:
        return PartMeasure(views, None, ())
    body = _refine(places, pictures, found)
    return PartMeasure(views, body, _intervals(found, _APART_PX / pictures.spread) if body is None else ())


def combine_parts(parts: Mapping[str, PartMeasure], stitch: Stitch) -> dict[str, PartHeight]:
    """Return the heights of all components of a run, by address, with the errors of matrices that they share."""
    bodies = {address: part.body for address, part in parts.items() if part.body is not None}
    estimates = combine(bodies, _row_sigma_px(stitch))
    out = {}
    for address, part in parts.items():
        mm, sigma = estimates.get(address, (None, None))
        out[address] = PartHeight(mm, sigma, part.intervals if mm is None else (), part.views)
    return out


def _highest_mm(grid: PartGrid, body_height: float | None, board_type: BoardType) -> float:
    """Return the largest height that is searched for a component."""
    longest_mm = max(grid.width, grid.height) * grid.mm_per_px
    slender = min(HIGHEST_MM, max(_LEAST_HIGHEST_MM, _SLENDER * longest_mm))
    return max(slender, 1.5 * (body_height or 0.0) * board_type.mm_per_unit)


def open_places(board_type: BoardType, stitch: Stitch, cameras: Sequence[Camera]) -> Places:
    """Return where the components of a run lie in its frames; raise StateError if heights cannot be computed."""
    if all(camera.working_distance_mm is None for camera in cameras):
        raise StateError(
            "the calibration has no working_distance_mm, so heights of components cannot be measured.",
            action="Measure the height of the cameras above the calibrated plane and state it in the calibration.",
            code="no-working-distance",
        )
    return Places(board_type, stitch, cameras)


def _count(grid: PartGrid, frames: Frames) -> int:
    return sum(frames.get((camera, row), grid.level) is not None for camera, row in grid.keys.tolist())


def _sweep(places: Places, pictures: Pictures, highest_mm: float) -> _Swept | None:
    """Compute the probability of every height of the body, and the tiles that show it."""
    grid = pictures.grid
    feet, distance = grid.feet_px, grid.distance_mm
    step = max(STEP_PX / pictures.spread, highest_mm / _MOST_STEPS)
    heights = np.asarray(np.arange(-2, math.ceil(highest_mm / step) + 1) * step, np.float64)
    cut = cut_pictures(places, pictures, float(heights[0]), float(heights[-1]))
    stack, margin = surface_stack(places, pictures, cut)
    tiles = _tiles(grid)
    for saturated in (SATURATED, math.inf):
        found = sweep(stack, margin, feet, heights[:, None] / distance, tiles, pictures.group, saturated)
        shown = found.freedom > 0
        if shown.all() or shown[_in_the_middle(tiles, grid)].mean() >= _MIDDLE:
            break
    else:
        return None
    found, tiles = Sweep(found.sums[shown], found.texture[shown], found.freedom[shown], found.used[shown]), tiles[shown]
    at_board = np.abs(heights) * pictures.spread <= _BOARD_PX
    size = np.array([grid.width, grid.height])
    prior = np.where(heights < -1e-9, -_BELOW_BOARD, 0.0)
    levels = find_levels(*compare_heights(found, at_board, NOISE_AREA, 0.0), heights, tiles, size, prior)
    probability, best = levels.probability, int(levels.probability.argmax())
    far = np.abs(heights - heights[best]) * pictures.spread > _APART_PX
    if (probability[far] > _SEEMING).any():
        # What explains the pictures up to the tolerance `UNLIKE` is named too.
        likely = compare_heights(found, at_board, NOISE_AREA, UNLIKE)
        other = find_levels(*likely, heights, tiles, size, prior).probability
        other = other * (probability[best] / max(other[~far].max(), 1e-12))
        probability = np.where(far, np.maximum(probability, other), probability)
        probability /= probability.sum()
    mine = levels.on_body > 0.5
    # The mean of two: by the pictures alone, and with a prior of low bodies. So neither decides alone.
    low = probability * np.exp(-np.maximum(heights, 0.0) / (max(grid.width, grid.height) * grid.mm_per_px))
    return _Swept(heights, (probability + low / low.sum()) / 2, tiles[mine], found.used[mine], cut)


def _refine(places: Places, pictures: Pictures, swept: _Swept) -> BodyEquations | None:
    """Compute the equations of the most probable height; None if it is not probable enough, or without texture."""
    heights, probability, tiles, used, cut = swept
    best = int(probability.argmax())
    near = np.abs(heights - heights[best]) * pictures.spread <= _NEAR_PX + 1e-6
    if probability[near].sum() < _SURE or not len(tiles):
        return None
    h, feet, distance = float(heights[best]), pictures.grid.feet_px, pictures.grid.distance_mm
    centre = tiles[:, :2] + tiles[:, 2:] / 2 - 0.5
    lowest = _LOWEST_NOISE / 4**pictures.grid.level
    edge_mm = _EDGE_PX / 2**pictures.grid.level / pictures.spread
    body: BodyEquations | None = None
    for _ in range(_ROUNDS):
        stack = picture_stack(places, pictures, cut, 2, h)
        lean = (centre[:, None] - feet[None]) / (distance - h)[None, :, None]
        found = normal_equations(stack, lean, tiles + (2, 2, 0, 0), used, pictures.group)
        if not (found.variance > 0).any():
            return None
        equations = weigh_tiles(found, tiles, lowest, edge_mm)
        weight = tile_weights(equations.matrix, equations.vector, equations.noisy)
        if not weight.any():
            return None
        step_mm, matrix, vector = add_up(equations, weight)
        body = BodyEquations(h, step_mm, matrix, vector, 1.0)
        limit = 0.7 / pictures.spread
        moved = min(max(step_mm, -limit), limit)
        h += moved
        if abs(moved) * pictures.spread < _CONVERGED_PX:
            break
    if body is None or abs(h - heights[best]) * pictures.spread > _NEAR_PX:
        return None
    common = equations.unlike_mm
    if _in_one_line(tiles, pictures.grid):
        common = math.hypot(common, _ONE_LINE * abs(h))
    return body._replace(scale=2.0**pictures.grid.level, unlike_mm=common)


def _in_the_middle(tiles: NDArray[np.int_], grid: PartGrid) -> NDArray[np.bool_]:
    """Return which tiles (t,) lie in the part of a footprint that every extent of a body contains."""
    half = np.array([grid.width, grid.height]) / 2
    off = np.abs(tiles[:, :2] + tiles[:, 2:] / 2 - half)
    return np.asarray((off <= np.maximum(EXTENTS[:, :2].min() * half, off.min(0) + 0.5)).all(1))


def _in_one_line(tiles: NDArray[np.int_], grid: PartGrid) -> bool:
    """Return whether the tiles of a body are one row or column of three, or at most two of more.

    They may lie on an edge of the body and all see the same mixture of body and board.
    """
    for k, length in enumerate((grid.width, grid.height)):
        mine, all_of = len(set(tiles[:, k].tolist())), len(_cut(length)[0])
        if (mine == 1 and all_of == 3) or (mine <= 2 and all_of > 3):
            return True
    return False


def _tiles(grid: PartGrid) -> NDArray[np.int_]:
    """Return the tiles (t, 4) of a footprint: first column, first row, width, height."""
    xs, w = _cut(grid.width)
    ys, h = _cut(grid.height)
    return np.array([(x, y, w, h) for y in ys for x in xs])


def _cut(length: int) -> tuple[list[int], int]:
    """Cut a side without its border pixels into pieces of one size; return their first pixels and this size."""
    inset = max(1, min(_INSET_PX, length // 10))
    inner = length - 2 * inset
    size = min(max(_TILE_PX[0], min(_TILE_PX[1], inner // 4)), inner)
    count = max(1, inner // size)
    if count == 1:
        return [inset + (inner - size) // 2], size
    return [inset + round(n * (inner - size) / (count - 1)) for n in range(count)], size


def _intervals(swept: _Swept, apart_mm: float) -> tuple[Interval, ...]:
    """Return the intervals that contain the height; none if they are the whole range.

    The least probable heights are left out, `1 - _ALL` together. Heights that differ by less than `apart_mm` are one
    interval.
    """
    heights, probability = swept.heights_mm, swept.probability
    order = np.argsort(-probability, kind="stable")
    kept = np.sort(order[: int(np.searchsorted(np.cumsum(probability[order]), _ALL)) + 1])
    step = float(heights[1] - heights[0])
    found = []
    for part in np.split(kept, np.flatnonzero(np.diff(heights[kept]) > apart_mm) + 1):
        low, high = float(heights[part[0]]) - step, float(heights[part[-1]]) + step
        found.append(Interval(max(low, 0.0), max(high, 0.0), float(probability[part[0] : part[-1] + 1].sum())))
    whole = sum(i.high_mm - i.low_mm for i in found) > 0.95 * float(heights[-1] - heights[0])
    return () if whole else tuple(found)


def _row_sigma_px(stitch: Stitch) -> float:
    """Return the typical standard deviation of a row's position, px; 0 in results that do not state it."""
    values = stitch.quality.get("row_sigma_px") or [0.0]
    return float(np.median(np.asarray(values, np.float64)))


Comparison = Literal["agrees", "lower", "higher", "ambiguous", "unknown"]
TOLERANCE_MM, TOLERANCE_SHARE = 0.1, 0.1
"""A body may differ from its expected height by this, or by this share of it, whichever is larger."""
_LEAST, _LEAST_OTHER = 0.95, 0.995
"""Least probability of "agrees", and of "lower" and "higher": few bodies are other than expected."""

_EDGE = 0.1
"""Uncertainty of the ends of an interval, as a share of its width: the pictures fall off slowly there."""
_WIDE, _WIDER = 0.03, 5.0
"""Share of the heights that err more than their standard deviation says, and the factor by which it is too small."""


def compare(height: PartHeight, expected_mm: float) -> tuple[Comparison, float]:
    """Compare a height with the expected one; return the most probable statement and its probability.

    The statement is "ambiguous" or "unknown" if none is probable enough: several intervals are left, or one, or
    nothing is known. The probability is that of the most probable one of the others. The expected height has no part in
    it, and an interval counts only for what all of it says.
    """
    tolerance = max(TOLERANCE_MM, TOLERANCE_SHARE * expected_mm)
    low, high = expected_mm - tolerance, expected_mm + tolerance
    if height.height_mm is not None and height.sigma_mm is not None:
        lower = _beyond(height.height_mm - low, height.sigma_mm)
        higher = _beyond(high - height.height_mm, height.sigma_mm)
        agrees = max(0.0, 1 - lower - higher)
    else:
        lower = sum(i.probability for i in height.intervals if i.high_mm + _edge_mm(i) <= low)
        higher = sum(i.probability for i in height.intervals if i.low_mm - _edge_mm(i) >= high)
        agrees = sum(i.probability for i in height.intervals if low <= i.low_mm and i.high_mm <= high)
    chances: dict[Comparison, float] = {"agrees": agrees, "lower": lower, "higher": higher}
    best = max(chances, key=lambda name: chances[name])
    if chances[best] >= (_LEAST if best == "agrees" else _LEAST_OTHER):
        return best, chances[best]
    return ("ambiguous" if len(height.intervals) > 1 else "unknown"), chances[best]


def _edge_mm(interval: Interval) -> float:
    """Return how uncertain the ends of an interval are, mm."""
    return _EDGE * (interval.high_mm - interval.low_mm)


def _beyond(distance_mm: float, sigma_mm: float) -> float:
    """Return the probability that a height errs by more than a distance."""
    z = distance_mm / (sigma_mm * math.sqrt(2))
    return ((1 - _WIDE) * math.erfc(z) + _WIDE * math.erfc(z / _WIDER)) / 2


def heights_document(heights: Mapping[str, PartHeight], board_type: BoardType) -> dict[str, dict[str, Any]]:
    """Return the heights as they are written to files and served: one object per component, by address."""
    out = {}
    for component in board_type.components:
        found = heights.get(component.address)
        if found is None:
            continue
        entry: dict[str, Any] = {
            "height_mm": _rounded(found.height_mm),
            "sigma_mm": _rounded(found.sigma_mm),
            "views": found.views,
        }
        if found.height_mm is None:
            entry |= {
                "low_mm": _rounded(found.intervals[0].low_mm) if found.intervals else None,
                "high_mm": _rounded(found.intervals[-1].high_mm) if found.intervals else None,
            }
        if len(found.intervals) > 1:
            entry["intervals"] = [{k: _rounded(v) for k, v in i._asdict().items()} for i in found.intervals]
        if component.body_height is not None:
            expected = component.body_height * board_type.mm_per_unit
            statement, probability = compare(found, expected)
            entry |= {
                "expected_mm": _rounded(expected),
                "comparison": statement,
                "probability": _rounded(probability),
            }
        out[component.address] = entry
    return out


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 4)


_FULL = 255.0


def equalised_frames(
    frame: Callable[[int, int], NDArray[Any] | None], fields: FlatFields, lights: Sequence[str] = ()
) -> Callable[[int, int], NDArray[Any] | None]:
    """Return a function of camera and row that gives (grey − dark) / flat as 32-bit floats; None for a missing frame.

    Saturated pixels stay saturated.
    """

    def equalised(camera: int, row: int) -> NDArray[Any] | None:
        pixels = frame(camera, row)
        if pixels is None:
            return None
        grey = eight_bit_grey(pixels)
        maps = fields.maps(camera, lights[row] if lights else None)
        flat = np.float32(1) if maps.flat is None else np.maximum(maps.flat, np.float32(0.02))
        # In place, because a worker does this between the urgent tasks of a board that passes.
        value = np.subtract(grey, np.asarray(maps.dark, np.float32), dtype=np.float32)
        np.divide(value, flat, out=value)
        full = grey >= _FULL
        value[full] = np.maximum(value[full], np.float32(_FULL))
        return value

    return equalised
