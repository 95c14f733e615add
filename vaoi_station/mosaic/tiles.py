"""Pixels of any part of a mosaic, rendered from the frames that show it.

Without HDR, grey levels are those of the frames after correction: dark level subtracted, divided by the field of the
camera and the gain of the frame. Two frames meet at a seam with weights that change over one cell (16 px of the
cameras). With HDR each layer gives radiance and its noise, and the layers are merged by their noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.mosaic.cells import CELL_PX
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
                    parts.append(self._part(number, int(n), box, cad, mine))
        shift = np.array([[1, 0, x0], [0, 1, y0], [0, 0, 1]], dtype=np.float64)
        cells_from_tile = (self._cells_from_grid @ shift)[:2].copy()
        cells_from_tile[:, 2] -= low
        return TileSpec(x1 - x0, y1 - y0, plan.hdr, len(plan.layers), cells_from_tile, tuple(parts))

    def _part(self, layer: int, number: int, box: Box, cad: Floats, mine: NDArray[np.uint8] | None) -> FramePart:
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
            photometry.dark,
            taken.gain,
            photometry.noise,
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
    total: Floats32 | None = None
    weights = np.zeros((spec.height, spec.width), np.float32)
    dtype: np.dtype[Any] = np.dtype(np.uint8)
    for part in spec.parts:
        pixels = _cut(part, read)
        if pixels is None:
            continue
        dtype = pixels.dtype
        unit = 1.0 if dtype == np.uint8 else 257.0
        warped = cv2.warpPerspective(pixels, _matrix(part), (spec.width, spec.height), flags=_LINEAR)
        value = _corrected(warped, _spread(part.factor, spec), part.dark * unit)
        weight = _weight(part, spec)
        if weight is None and len(spec.parts) == 1:
            return np.asarray(_whole(value, dtype))
        weight = np.ones_like(weights) if weight is None else weight
        weights += weight
        value *= weight if value.ndim == 2 else weight[..., None]
        total = value if total is None else total + value
    if total is None or not weights.any():
        return None
    shown = weights > 0
    np.maximum(weights, 1e-6, out=weights)
    picture = _whole(total / (weights if total.ndim == 2 else weights[..., None]), dtype)
    picture[~shown] = NODATA
    return np.asarray(picture)


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


def _corrected(warped: NDArray[Any], factor: Floats32, dark: float) -> Floats32:
    """Return (grey − dark) · factor, float32."""
    if warped.ndim == 3:
        factor = np.asarray(cv2.merge([factor] * warped.shape[2]))
    value = cv2.multiply(warped, factor, dtype=cv2.CV_32F)
    if dark:
        value = cv2.scaleAdd(factor, -dark, value)
    return np.asarray(value, np.float32)


def _whole(value: Floats32, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Round to 8 or 16 bits; at least 1, since 0 marks what no frame shows."""
    full = 255 if dtype == np.uint8 else 65535
    return np.rint(np.clip(value, NODATA + 1, full)).astype(dtype)


def _grey_levels(pixels: NDArray[Any]) -> Floats32:
    grey = pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY))
    return np.asarray(grey, np.float32) * np.float32(1.0 if grey.dtype == np.uint8 else 255 / 65535)
