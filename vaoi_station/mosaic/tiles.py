"""Pixels of any part of a mosaic, rendered from the frames that show it.

Without HDR, grey levels are those of the frames after correction: dark level subtracted, divided by the field of the
camera and the gain of the frame. Two frames meet at a seam with weights that change over one cell (16 px of the
cameras). With HDR each layer gives radiance and its noise, and the layers are merged by their noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.mosaic.blending import Cells, Nodes, Pictures, blend, nodes_along
from vaoi_station.mosaic.cells import CELL_PX
from vaoi_station.mosaic.frames import TakenFrame
from vaoi_station.mosaic.grid import MosaicGrid
from vaoi_station.mosaic.plan import FIELD_PX, MosaicPlan
from vaoi_station.mosaic.projection import FrameProjector, between, shrunk
from vaoi_station.mosaic.survey import Floats32, ReadFrame
from vaoi_station.photometry import NoiseModel, Radiance, merge
from vaoi_station.photometry.radiance import is_saturated

Box = tuple[int, int, int, int]
"""Part x0, y0, x1, y1 of a mosaic in pixels, ends excluded."""
NODATA = 0
"""Value of pixels of 8 or 16 bits that no frame shows; shown pixels are at least 1. Floats are NaN there."""
_LINEAR = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
_NEAREST = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
_NARROW_PX = 256
_STRAIGHT_PX = 0.03
"""Largest deviation, px, of a matrix from lens and surface in parts that are wider than 256 px."""
_CALL_PX = 2000
"""Number of pixels that are resampled in the time that a call takes."""
_BORDER_PX = 3
"""Pixels around the part of a frame that is read, so that interpolation has its neighbours."""


class FramePart(NamedTuple):
    """What one frame contributes to a tile."""

    layer: int
    camera: int
    row: int
    raw_from_tile: Floats
    """(3, 3) matrix from pixels of the tile to raw pixels of the frame, for the part in which the frame has a weight.
    """
    crop: Box
    """Part of the frame that this part shows; its sides are multiples of `reduction`."""
    wholly: bool
    """Whether the frame shows all of this part."""
    reduction: int
    """By how much the frame is reduced before it is resampled: pixels of the tile are larger."""
    factor: Floats32
    """(h, w) of the cells of the tile: what corrected grey levels are multiplied by."""
    mine: NDArray[np.uint8] | None
    """(h, w) of the cells of the tile: 1 for cells of this frame; None if all are."""
    limits: Floats
    """(4,) least x and y, largest x and y of raw pixels that may be used: the outermost are left out."""
    dark: float
    gain: float
    noise: NoiseModel


@dataclass(frozen=True, eq=False)
class TileSpec:
    """All that is needed to render a tile, apart from the pixels of its frames."""

    width: int
    height: int
    hdr: bool
    layers: int
    cells_from_tile: Floats
    """(2, 3) matrix from pixels of the tile to cells."""
    parts: tuple[FramePart, ...]


class TileRenderer:
    """Prepares tiles of a plan on one grid; rendering them needs frames only."""

    def __init__(self, plan: MosaicPlan, projector: FrameProjector, grid: MosaicGrid) -> None:
        self._plan, self._projector, self.grid = plan, projector, grid
        base_from_grid = plan.base.mosaic_from_cad @ grid.cad_from_mosaic
        self._cells_from_grid = between(base_from_grid, CELL_PX, 1)
        per_base_px = float(base_from_grid[0, 0])
        self._reduction = 2 ** max(int(np.floor(np.log2(max(per_base_px, 1.0)) + 0.01)), 0)

    @cached_property
    def block_px(self) -> int:
        """Width of the parts in which a large picture is rendered: a multiple of 256 px.

        The wider, the faster; but within one part a frame is resampled by one matrix, which must represent lens and
        surface to `_STRAIGHT_PX`. With HDR, several arrays of floats must fit into memory.
        """
        for width in (1024, 512) if self._plan.hdr else (4096, 2048, 1024, 512):
            bent = 0.0
            for taken, _ in self._plan.frames:
                x0, y0, x1, y1 = self._projector.seen_box(taken.camera, taken.row, self.grid)
                if min(x1 - x0, y1 - y0) >= _NARROW_PX:
                    shown = min(width, x1 - x0)
                    y = (y0 + y1 - _NARROW_PX) // 2
                    for x in (x0, (x0 + x1 - shown) // 2, x1 - shown):
                        bent = max(bent, self._bend(taken, (x, y, x + shown, y + _NARROW_PX)))
            if bent <= _STRAIGHT_PX:
                return width
        return _NARROW_PX

    def _bend(self, taken: TakenFrame, box: Box) -> float:
        """Return how far the matrix of a part deviates from the projection on a grid of points, px."""
        x, y = np.linspace(box[0], box[2], 5) - 0.5, np.linspace(box[1], box[3], 3) - 0.5
        at = np.stack(np.meshgrid(x, y), -1)
        matrix = self._projector.raw_from_mosaic(taken.camera, taken.row, self.grid, box)
        exact = self._projector.raw_px(taken.camera, taken.row, apply(self.grid.cad_from_mosaic, at))
        return float(np.abs(apply(matrix, at) - exact).max())

    def spec(self, box: Box) -> TileSpec:
        """Prepare one tile."""
        x0, y0, x1, y1 = box
        plan, shape = self._plan, self._plan.layers[0].shape
        ends = apply(self._cells_from_grid, np.array([(x0 - 0.5, y0 - 0.5), (x1 - 0.5, y1 - 0.5)]))
        # One more cell on each side: weights and factors are interpolated between the centres of cells.
        low = np.clip(np.floor(ends[0]).astype(int), 0, np.array(shape[::-1]) - 1)
        high = np.clip(np.ceil(ends[1]).astype(int) + 1, low + 1, shape[::-1])
        cells = np.s_[low[1] : high[1], low[0] : high[0]]
        shift = np.array([[1, 0, x0], [0, 1, y0], [0, 0, 1]], dtype=np.float64)
        cells_from_tile = self._cells_from_grid @ shift
        cells_from_tile[:2, 2] -= low
        tile_from_cells = np.asarray(np.linalg.inv(cells_from_tile), np.float64)
        parts = []
        for number, layer in enumerate(plan.layers):
            labels = layer[cells]
            for n in np.unique(labels):
                if n >= 0:
                    mine = None if (labels == n).all() else (labels == n).astype(np.uint8)
                    window = _window(mine, tile_from_cells, (x1 - x0, y1 - y0))
                    if window[2] > window[0] and window[3] > window[1]:
                        parts.append(self._part(number, int(n), box, window, tile_from_cells, mine, labels.shape))
        return TileSpec(x1 - x0, y1 - y0, plan.hdr, len(plan.layers), cells_from_tile[:2], tuple(parts))

    def _part(
        self,
        layer: int,
        number: int,
        box: Box,
        window: Box,
        tile_from_cells: Floats,
        mine: NDArray[np.uint8] | None,
        cells: tuple[int, ...],
    ) -> FramePart:
        plan = self._plan
        taken, log_gain = plan.frames[number]
        photometry = plan.cameras[taken.camera]
        eye = self._projector.cameras[taken.camera]
        x0, y0, x1, y1 = window
        place = box[0] + x0, box[1] + y0, box[0] + x1, box[1] + y1
        matrix = self._projector.raw_from_mosaic(taken.camera, taken.row, self.grid, place)
        matrix[:, 2] += box[0] * matrix[:, 0] + box[1] * matrix[:, 1]
        # Between the cells of one tile the lens matters less to the field than one of its pixels.
        field_from_cells = between(matrix @ tile_from_cells, FIELD_PX, 1)
        field = cv2.warpPerspective(
            photometry.field, field_from_cells, cells[::-1], flags=_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        scale = math.exp(-log_gain) * (1.0 if plan.hdr else plan.reference_us) / taken.sensitivity
        corners = apply(matrix, np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]) - 0.5)
        low, high = corners.min(0).tolist(), corners.max(0).tolist()
        limits = 1.0, 1.0, eye.width_px - 2.0, eye.height_px - 2.0
        inside = low[0] >= limits[0] and low[1] >= limits[1] and high[0] <= limits[2] and high[1] <= limits[3]
        return FramePart(
            layer,
            taken.camera,
            taken.row,
            matrix,
            _crop(low, high, (eye.width_px, eye.height_px), self._reduction),
            inside,
            self._reduction,
            np.asarray(np.float32(scale) / field, np.float32),
            mine,
            np.array(limits),
            photometry.dark,
            taken.gain,
            photometry.noise,
        )


def _window(mine: NDArray[np.uint8] | None, tile_from_cells: Floats, size: tuple[int, int]) -> Box:
    """Return the part of a tile of this width and height in which a frame's cells have a weight; may be empty."""
    if mine is None:
        return 0, 0, *size
    ends = []
    for axis, shown in enumerate((mine.any(0), mine.any(1))):
        at = np.flatnonzero(shown)
        # The weight of a cell reaches to the centres of its neighbours.
        scale, shift = float(tile_from_cells[axis, axis]), float(tile_from_cells[axis, 2])
        first, last = math.floor(scale * (at[0] - 1) + shift), math.ceil(scale * (at[-1] + 1) + shift) + 1
        ends.append((max(first, 0), min(last, size[axis])))
    return ends[0][0], ends[1][0], ends[0][1], ends[1][1]


def _crop(low: Sequence[float], high: Sequence[float], size: tuple[int, int], reduction: int) -> Box:
    """Return the part of a frame around raw positions from `low` to `high`; its sides are multiples of `reduction`."""
    # Plain numbers: numpy takes ten times as long for vectors of two, and there are several parts in each tile.
    border, ends = _BORDER_PX * reduction, []
    for a, b, most in zip(low, high, size, strict=True):
        first = max(math.floor(min(max(0.0, a), most)) - border, 0) // reduction * reduction
        last = min(math.ceil(min(max(0.0, b), most)) + border, most)
        ends.append((first, first + (last - first) // reduction * reduction))
    return ends[0][0], ends[1][0], ends[0][1], ends[1][1]


def render_tile(spec: TileSpec, read: ReadFrame) -> NDArray[Any] | None:
    """Render a tile from its frames; None if no frame shows any of it.

    Returns pixels (h, w) or (h, w, 3) of the type of the frames; with HDR radiance (h, w), float32.
    """
    if spec.hdr:
        return _render_hdr(spec, read)
    found = [(part, pixels) for part in spec.parts if (pixels := _cut(part, read)) is not None]
    if not found:
        return None
    first = found[0][1]
    channels = 1 if first.ndim == 2 else first.shape[2]
    cells = _cells([part for part, _ in found])
    m = spec.cells_from_tile
    x = nodes_along(m[0, 2], m[0, 0], spec.width, cells.part.shape[1])
    y = nodes_along(m[1, 2], m[1, 1], spec.height, cells.part.shape[0])
    pictures = _resampled(found, x, y)
    out = np.empty((spec.height, spec.width * channels), first.dtype)
    every = x if channels == 1 else Nodes(np.repeat(x.cell, channels), np.repeat(x.share, channels))
    blend(pictures, cells, every, y, channels, 255.0 if first.dtype == np.uint8 else 65535.0, out)
    if not out.any():
        return None
    return out if channels == 1 else out.reshape(spec.height, spec.width, channels)


def _cells(parts: Sequence[FramePart]) -> Cells:
    """Return which of these parts each cell of a tile shows, and its factor."""
    number, factor = np.full(parts[0].factor.shape, -1, np.int32), np.ones_like(parts[0].factor)
    for n, part in enumerate(parts):
        mine = True if part.mine is None else part.mine.view(bool)
        np.copyto(number, n, where=mine)
        np.copyto(factor, part.factor, where=mine)
    return Cells(number, factor)


def _resampled(found: Sequence[tuple[FramePart, NDArray[Any]]], x: Nodes, y: Nodes) -> Pictures:
    """Resample the frames of a tile where they have a weight; `x` and `y` are the places of its pixels among cells."""
    rows, columns = found[0][0].factor.shape
    # Where the pixels begin that lie after the centre of a cell, from the one before the first to the one after the
    # last.
    lefts = np.searchsorted(x.cell, np.arange(-1, columns + 1)).tolist()
    tops = np.searchsorted(y.cell, np.arange(rows + 1)).tolist()
    windows = [_windows(part.mine, lefts, tops) for part, _ in found]
    place, size = np.zeros((len(found), 4), np.int64), 0
    channels = found[0][1].shape[2:]
    depth = int(np.prod(channels, dtype=int))
    for n, boxes in enumerate(windows):
        left, right = min(box[0] for box in boxes), max(box[2] for box in boxes)
        top, bottom = boxes[0][1], boxes[-1][3]
        place[n] = size * depth, left, top, right - left
        size += (right - left) * (bottom - top)
    pixels = np.empty(size * depth, found[0][1].dtype)
    for (part, frame), boxes, (start, left, top, width) in zip(found, windows, place.tolist(), strict=True):
        height = boxes[-1][3] - top
        area = pixels[start : start + width * height * depth].reshape(height, width, *channels)
        matrix = _matrix(part)
        for x0, y0, x1, y1 in boxes:
            moved = matrix.copy()
            moved[:, 2] += x0 * matrix[:, 0] + y0 * matrix[:, 1]
            goal = area[y0 - top : y1 - top, x0 - left : x1 - left]
            cv2.warpPerspective(frame, moved, (x1 - x0, y1 - y0), dst=goal, flags=_LINEAR)
    parts, unit = [part for part, _ in found], 1.0 if pixels.dtype == np.uint8 else 257.0
    return Pictures(
        pixels,
        place,
        np.array([part.dark * unit for part in parts], np.float32),
        np.stack([part.raw_from_tile for part in parts]),
        np.stack([part.limits for part in parts]),
    )


def _windows(mine: NDArray[np.uint8] | None, lefts: Sequence[int], tops: Sequence[int]) -> list[Box]:
    """Return rectangles of a tile that hold all pixels in which a frame has a weight, from top to bottom.

    The frame's share of a tile is rarely a rectangle. Each row of cells has one rectangle; neighbours are joined if
    that costs less than a call.

    Args:
        mine: (h, w) 1 for cells of the frame; None if all are.
        lefts: (w + 2,) the first pixel after the centre of each column of cells, from the column before the first.
        tops: (h + 1,) the first pixel after the centre of each row of cells.
    """
    if mine is None:
        return [(0, 0, lefts[-1], tops[-1])]
    # Between two rows of cells both have a weight.
    either = mine.copy()
    either[:-1] |= mine[1:]
    first, last = either.argmax(1).tolist(), (mine.shape[1] - 1 - either[:, ::-1].argmax(1)).tolist()
    boxes: list[Box] = []
    for row in np.flatnonzero(either.any(1)).tolist():
        x0, y0, x1, y1 = lefts[first[row]], tops[row], lefts[last[row] + 2], tops[row + 1]
        if boxes and y1 > y0:
            a, b, c, d = boxes[-1]
            joined = min(a, x0), b, max(c, x1), y1
            more = (joined[2] - joined[0]) * (y1 - b) - (c - a) * (d - b) - (x1 - x0) * (y1 - y0)
            if more <= _CALL_PX:
                boxes[-1] = joined
                continue
        if y1 > y0 and x1 > x0:
            boxes.append((x0, y0, x1, y1))
    return boxes or [(0, 0, 0, 0)]


def _render_hdr(spec: TileSpec, read: ReadFrame) -> NDArray[Any] | None:
    """Render radiance: blend the frames of each layer, then merge the layers by their noise."""
    shape = spec.height, spec.width
    totals: dict[int, list[Floats32]] = {}
    for part in spec.parts:
        pixels = _cut(part, read)
        if pixels is None:
            continue
        size = (spec.width, spec.height)
        grey = _grey_levels(pixels)
        warped = cv2.warpPerspective(grey, _matrix(part), size, flags=_LINEAR)
        factor = _spread(part.factor, spec)
        signal = warped - np.float32(part.dark)
        sigma = np.sqrt(part.noise.variance(cv2.blur(signal, (3, 3)), part.gain)) * factor
        weight = _weight(part, spec)
        weight = np.ones(shape, np.float32) if weight is None else weight
        saturated = is_saturated(pixels).astype(np.uint8)
        if saturated.any():
            weight = weight * (cv2.warpPerspective(saturated, _matrix(part), size, flags=_NEAREST) == 0)
        value, noise, weights = totals.setdefault(part.layer, [np.zeros(shape, np.float32) for _ in range(3)])
        value += weight * signal * factor
        noise += weight * sigma
        weights += weight
    if not totals:
        return None
    stack = []
    for value, noise, weights in totals.values():
        valid = weights > 1e-3
        share = np.where(valid, weights, np.float32(1))
        mean = np.where(valid, value / share, np.float32(np.nan))
        stack.append(Radiance(mean, np.where(valid, noise / share, np.float32(np.inf)), valid))
    return merge(stack).value


def _cut(part: FramePart, read: ReadFrame) -> NDArray[Any] | None:
    """Return the part of a frame that a tile shows, reduced; None if the frame is missing or the part is empty."""
    x0, y0, x1, y1 = part.crop
    if x1 <= x0 or y1 <= y0:
        return None
    frame = read(part.camera, part.row)
    return None if frame is None else shrunk(frame[y0:y1, x0:x1], part.reduction)


def _matrix(part: FramePart) -> Floats:
    """Return the matrix from pixels of the tile to pixels of the reduced part of the frame."""
    matrix = part.raw_from_tile.copy()
    matrix[:2] -= np.array([part.crop[:2]]).T * matrix[2]
    return between(matrix, part.reduction, 1)


def _spread(values: NDArray[Any], spec: TileSpec) -> Floats32:
    """Interpolate values (h, w) of cells over the pixels of a tile."""
    size = (spec.width, spec.height)
    return np.asarray(
        cv2.warpAffine(values, spec.cells_from_tile, size, flags=_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32
    )


def _weight(part: FramePart, spec: TileSpec) -> Floats32 | None:
    """Return the weight of a frame at each pixel of a tile; None if it is 1 everywhere."""
    weight = None if part.mine is None else _spread(part.mine.astype(np.float32), spec)
    if part.wholly:
        return weight
    x0, y0, x1, y1 = part.crop
    h, w = (y1 - y0) // part.reduction, (x1 - x0) // part.reduction
    seen = np.ones((h, w), np.uint8)
    # The outermost pixels are left out: half of their interpolation would come from beside the frame.
    seen[[0, -1]] = seen[:, [0, -1]] = 0
    inside = cv2.warpPerspective(seen, _matrix(part), (spec.width, spec.height), flags=_NEAREST)
    return np.asarray(inside, np.float32) if weight is None else np.asarray(weight * inside, np.float32)


def _grey_levels(pixels: NDArray[Any]) -> Floats32:
    grey = pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY))
    return np.asarray(grey, np.float32) * np.float32(1.0 if grey.dtype == np.uint8 else 255 / 65535)
