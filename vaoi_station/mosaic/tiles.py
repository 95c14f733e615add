"""Pixels of any part of a mosaic, rendered from the frames that show it.

Without HDR, grey levels are those of the frames after correction: dark level subtracted, divided by the field of the
camera and the gain of the frame. Two frames meet at a seam with weights that change over one cell (16 px of the
cameras). With HDR each layer gives radiance and its noise, and the layers are merged by their noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.mosaic.blending import Corrections, Nodes, add_frame, finish, nodes_along
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
_WINDOW_PX = 256
"""Side of the squares in which a frame is resampled."""
_BORDER_PX = 3
"""Pixels around the part of a frame that is read, so that interpolation has its neighbours."""


class FramePart(NamedTuple):
    """What one frame contributes to a tile."""

    layer: int
    camera: int
    row: int
    raw_from_tile: Floats
    """(3, 3) matrix from pixels of the tile to raw pixels of the frame."""
    crop: Box
    """Part of the frame that the tile shows; its sides are multiples of `reduction`."""
    wholly: bool
    """Whether the frame shows all of the tile."""
    reduction: int
    """By how much the frame is reduced before it is resampled: pixels of the tile are larger."""
    factor: Floats32
    """(h, w) of the cells of the tile: what corrected grey levels are multiplied by."""
    mine: NDArray[np.uint8] | None
    """(h, w) of the cells of the tile: 1 for cells of this frame; None if all are."""
    window: Box
    """Part of the tile in which the frame has a weight."""
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
        self._per_base_px = float(base_from_grid[0, 0])

    @cached_property
    def block_px(self) -> int:
        """Width of the parts in which a large picture is rendered: a multiple of 256 px.

        The wider, the faster; but within one part a frame is resampled by one matrix, which must represent lens and
        surface to `_STRAIGHT_PX`.
        """
        for width in (1024, 512):
            bent = 0.0
            for taken, _ in self._plan.frames:
                x0, y0, x1, y1 = self._projector.seen_box(taken.camera, taken.row, self.grid)
                if min(x1 - x0, y1 - y0) >= _NARROW_PX:
                    at = (x0 + x1 - width) // 2, (y0 + y1 - _NARROW_PX) // 2
                    for x in (x0, at[0], max(x1 - width, x0)):
                        bent = max(bent, self._bend(taken, (x, at[1], x + width, at[1] + _NARROW_PX)))
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
        middle = np.stack(np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1])), -1).astype(np.float64)
        cad = apply(plan.base.cad_from_mosaic, middle * CELL_PX + (CELL_PX - 1) / 2)
        parts = []
        for number, layer in enumerate(plan.layers):
            labels = layer[cells]
            for n in np.unique(labels):
                if n >= 0:
                    mine = None if (labels == n).all() else (labels == n).astype(np.uint8)
                    parts.append(self._part(number, int(n), box, cad, mine, low))
        shift = np.array([[1, 0, x0], [0, 1, y0], [0, 0, 1]], dtype=np.float64)
        cells_from_tile = (self._cells_from_grid @ shift)[:2].copy()
        cells_from_tile[:, 2] -= low
        return TileSpec(x1 - x0, y1 - y0, plan.hdr, len(plan.layers), cells_from_tile, tuple(parts))

    def _part(
        self, layer: int, number: int, box: Box, cad: Floats, mine: NDArray[np.uint8] | None, low: Any
    ) -> FramePart:
        plan = self._plan
        taken, log_gain = plan.frames[number]
        photometry = plan.cameras[taken.camera]
        eye = self._projector.cameras[taken.camera]
        raw = self._projector.raw_px(taken.camera, taken.row, cad)
        at = ((raw + 0.5) / FIELD_PX - 0.5).astype(np.float32)
        field = cv2.remap(photometry.field, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        scale = np.exp(-log_gain) * (1.0 if plan.hdr else plan.reference_us) / taken.sensitivity
        matrix = self._projector.raw_from_mosaic(taken.camera, taken.row, self.grid, box)
        shift = np.array([[1, 0, box[0]], [0, 1, box[1]], [0, 0, 1]], dtype=np.float64)
        matrix = matrix @ shift
        w, h = box[2] - box[0], box[3] - box[1]
        corners = apply(matrix, np.array([(-0.5, -0.5), (w - 0.5, -0.5), (w - 0.5, h - 0.5), (-0.5, h - 0.5)]))
        inside = eye.sees(corners, 1.0).all()
        reduction = 2 ** max(int(np.floor(np.log2(max(self._per_base_px, 1.0)) + 0.01)), 0)
        return FramePart(
            layer,
            taken.camera,
            taken.row,
            matrix,
            _crop(corners, (eye.width_px, eye.height_px), reduction),
            bool(inside),
            reduction,
            np.asarray(np.float32(scale) / field, np.float32),
            mine,
            self._window(mine, low, box),
            np.array([1.0, 1.0, eye.width_px - 2.0, eye.height_px - 2.0]),
            photometry.dark,
            taken.gain,
            photometry.noise,
        )

    def _window(self, mine: NDArray[np.uint8] | None, low: NDArray[np.int_], box: Box) -> Box:
        """Return the part of a tile in which cells of a frame, or their neighbours, lie; `low` is the first cell."""
        w, h = box[2] - box[0], box[3] - box[1]
        if mine is None:
            return 0, 0, w, h
        columns, rows = np.flatnonzero(mine.any(0)), np.flatnonzero(mine.any(1))
        # The weight of a cell reaches to the centres of its neighbours.
        first = low + (columns[0] - 1, rows[0] - 1)
        last = low + (columns[-1] + 1, rows[-1] + 1)
        grid_from_cells = np.linalg.inv(self._cells_from_grid)
        (x0, y0), (x1, y1) = apply(grid_from_cells, np.array([first, last], dtype=np.float64)) - box[:2]
        return (
            int(np.clip(np.floor(x0), 0, w)),
            int(np.clip(np.floor(y0), 0, h)),
            int(np.clip(np.ceil(x1) + 1, 0, w)),
            int(np.clip(np.ceil(y1) + 1, 0, h)),
        )


def _crop(corners: Floats, size: tuple[int, int], reduction: int) -> Box:
    """Return the part of a frame around raw positions, with sides that are multiples of `reduction`."""
    border = _BORDER_PX * reduction
    low = np.clip(np.floor(corners.min(0)).astype(int) - border, 0, size) // reduction * reduction
    high = np.clip(np.ceil(corners.max(0)).astype(int) + border, 0, size)
    high = low + (high - low) // reduction * reduction
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def render_tile(spec: TileSpec, read: ReadFrame) -> NDArray[Any] | None:
    """Render a tile from its frames; None if no frame shows any of it.

    Returns pixels (h, w) or (h, w, 3) of the type of the frames; with HDR radiance (h, w), float32.
    """
    if spec.hdr:
        return _render_hdr(spec, read)
    shape = spec.height, spec.width
    weights = np.zeros(shape, np.float32)
    total: Floats32 | None = None
    dtype: np.dtype[Any] = np.dtype(np.uint8)
    for part in spec.parts:
        pixels = _cut(part, read)
        if pixels is None:
            continue
        dtype = pixels.dtype
        if total is None:
            total = np.zeros((1 if pixels.ndim == 2 else pixels.shape[2], *shape), np.float32)
        for window in _windows(part, spec):
            _add(part, spec, window, pixels, total, weights)
    if total is None or not weights.any():
        return None
    full = 255.0 if dtype == np.uint8 else 65535.0
    channels = np.empty(total.shape, dtype)
    for channel, out in zip(total, channels, strict=True):
        finish(channel, weights, full, out)
    return np.asarray(channels[0] if len(channels) == 1 else cv2.merge(list(channels)))


def _windows(part: FramePart, spec: TileSpec) -> Iterator[Box]:
    """Yield the squares of a tile in which a frame has a weight: its share of a wide part is rarely a rectangle."""
    left, top, right, bottom = part.window
    m = spec.cells_from_tile
    for x0 in range(left, right, _WINDOW_PX):
        for y0 in range(top, bottom, _WINDOW_PX):
            x1, y1 = min(x0 + _WINDOW_PX, right), min(y0 + _WINDOW_PX, bottom)
            if part.mine is not None:
                c0, r0 = (max(int(v), 0) for v in (m[0, 2] + m[0, 0] * x0, m[1, 2] + m[1, 1] * y0))
                c1, r1 = int(m[0, 2] + m[0, 0] * x1) + 2, int(m[1, 2] + m[1, 1] * y1) + 2
                if not part.mine[r0:r1, c0:c1].any():
                    continue
            yield x0, y0, x1, y1


def _add(
    part: FramePart, spec: TileSpec, window: Box, pixels: NDArray[Any], total: Floats32, weights: Floats32
) -> None:
    """Add a frame to a square of a tile."""
    x0, y0, x1, y1 = window
    shift = np.array([[1, 0, x0], [0, 1, y0], [0, 0, 1]], dtype=np.float64)
    warped = cv2.warpPerspective(pixels, _matrix(part) @ shift, (x1 - x0, y1 - y0), flags=_LINEAR)
    x, y = _nodes(spec, part.factor.shape, window)
    mine = np.ones_like(part.factor) if part.mine is None else part.mine.astype(np.float32)
    unit = 1.0 if pixels.dtype == np.uint8 else 257.0
    corrections = Corrections(part.factor, mine, part.raw_from_tile @ shift, part.limits, part.dark * unit)
    channels = [warped] if warped.ndim == 2 else cv2.split(warped)
    before = weights.copy() if len(channels) > 1 else weights
    for number, channel in enumerate(channels):
        # Each channel adds the same weights, which count once.
        once = weights if number == 0 else before.copy()
        add_frame(total[number], once, np.asarray(channel), x, y, corrections, (x0, y0))


def _nodes(spec: TileSpec, cells: tuple[int, ...], window: Box) -> tuple[Nodes, Nodes]:
    """Return where the pixels of a part of a tile lie between the centres of the tile's cells."""
    m = spec.cells_from_tile
    x = nodes_along(m[0, 2] + m[0, 0] * window[0], m[0, 0], window[2] - window[0], cells[1])
    y = nodes_along(m[1, 2] + m[1, 1] * window[1], m[1, 1], window[3] - window[1], cells[0])
    return x, y


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
    shift = np.eye(3)
    shift[:2, 2] = -part.crop[0], -part.crop[1]
    return between(shift @ part.raw_from_tile, part.reduction, 1)


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
