"""What is needed to render a part of a mosaic, apart from pixels: its frames, their matrices, corrections and cells."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.frame_index import Box, FrameIndex
from vaoi_station.geometry import apply
from vaoi_station.geometry.homographies import between, of_part
from vaoi_station.geometry.transforms import Floats
from vaoi_station.mosaic.frames import TakenFrame
from vaoi_station.mosaic.gains import Floats32
from vaoi_station.mosaic.grid import MosaicGrid
from vaoi_station.mosaic.plan import CELL_PX, FIELD_PX, MosaicPlan, PlannedFrame
from vaoi_station.photometry import NoiseModel, WhiteBalance

_LINEAR = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
_STILL_PX = 0.1
"""A body whose top is displaced by less in all frames is shown in the plane of the board: the picture is the same."""
_PX_PER_BODY = 256
"""Area of a part of the picture, px², for each body that is shown in the plane of its top; the highest ones are."""
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
    """Part of the frame that this part shows. Its sides are multiples of `reduction`, except where the frame ends."""
    wholly: bool
    """Whether the frame shows all of this part."""
    reduction: int
    """By how much the frame is reduced before it is resampled: pixels of the tile are larger."""
    cells: Box
    """Part of the tile's cells that holds those of this frame, with one more on each side that the tile has."""
    factor: Floats32
    """(h, w) of `cells`: what corrected grey levels are multiplied by."""
    mine: NDArray[np.uint8] | None
    """(h, w) of `cells`: 1 for cells of this frame; None if all cells of the tile are."""
    window: Box
    """Part of the tile in which the frame has a weight."""
    limits: Floats
    """(4,) least x and y, largest x and y of raw pixels that may be used: the outermost are left out."""
    dark: float
    gain: float
    noise: NoiseModel
    white_balance: WhiteBalance | None = None


@dataclass(frozen=True, eq=False)
class TileSpec:
    """All that is needed to render a tile, apart from the pixels of its frames."""

    width: int
    height: int
    hdr: bool
    cells_from_tile: Floats
    """(2, 3) matrix from pixels of the tile to cells."""
    parts: tuple[FramePart, ...]
    bodies: tuple[BodyPart, ...] = ()
    """Bodies that the tile shows, the highest last."""


class BodyPart(NamedTuple):
    """The part of a tile around a body, in the plane of the body's top. It uses frames of the tile only."""

    first: tuple[int, int]
    """First column and row of the part in the tile."""
    corners: Floats
    """(4, 2) corners of the footprint in pixels of the part."""
    spec: TileSpec


class TileRenderer:
    """Prepares tiles of a plan on one grid; rendering them needs frames only."""

    def __init__(self, plan: MosaicPlan, projector: FrameIndex, grid: MosaicGrid) -> None:
        self._plan, self._projector, self.grid = plan, projector, grid
        base_from_grid = plan.base.mosaic_from_cad @ grid.cad_from_mosaic
        self._cells_from_grid = between(base_from_grid, CELL_PX, 1)
        per_base_px = float(base_from_grid[0, 0])
        self._bodies = _displaced(plan, projector, grid)
        self._reduction = 2 ** max(int(np.floor(np.log2(max(per_base_px, 1.0)) + 0.01)), 0)

    def spec(self, box: Box) -> TileSpec:
        """Prepare one tile."""
        return replace(self._spec(box, 0.0), bodies=tuple(self._body_parts(box)))

    def _body_parts(self, box: Box) -> Iterator[BodyPart]:
        """Yield the bodies that a tile shows, in the planes of their tops, the highest last."""
        bodies = self._bodies
        low = np.maximum(np.floor(bodies.corners.min(1) + 0.5).astype(int), box[:2])
        high = np.minimum(np.ceil(bodies.corners.max(1) + 0.5).astype(int), box[2:])
        most = max((box[2] - box[0]) * (box[3] - box[1]) // _PX_PER_BODY, 1)
        for n in np.flatnonzero((low < high).all(1))[-most:].tolist():
            x0, y0, x1, y1 = (int(v) for v in (*low[n], *high[n]))
            spec = self._spec((x0, y0, x1, y1), float(bodies.height_mm[n]))
            yield BodyPart((x0 - box[0], y0 - box[1]), bodies.corners[n] - low[n], spec)

    def _spec(self, box: Box, above_mm: float) -> TileSpec:
        """Prepare a part of the picture in the plane so far above the board."""
        x0, y0, x1, y1 = box
        plan, shape = self._plan, self._plan.layers[0].shape
        ends = apply(self._cells_from_grid, np.array([(x0 - 0.5, y0 - 0.5), (x1 - 0.5, y1 - 0.5)]))
        # One more cell on each side: weights and factors are interpolated between the centres of cells.
        low = np.clip(np.floor(ends[0]).astype(int), 0, np.array(shape[::-1]) - 1)
        high = np.clip(np.ceil(ends[1]).astype(int) + 1, low + 1, shape[::-1])
        cells = np.s_[low[1] : high[1], low[0] : high[0]]
        cells_from_tile = of_part(self._cells_from_grid, x0, y0)
        cells_from_tile[:2, 2] -= low
        tile_from_cells = np.asarray(np.linalg.inv(cells_from_tile), np.float64)
        parts = []
        for number, layer in enumerate(plan.layers):
            labels = layer[cells]
            for n in np.unique(labels[labels >= 0]).tolist():
                of_frame = labels == n
                columns, rows = (np.flatnonzero(of_frame.any(axis)) for axis in (0, 1))
                owned: Box = int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1
                window = _window(owned, labels.shape, tile_from_cells, (x1 - x0, y1 - y0))
                if window[2] > window[0] and window[3] > window[1]:
                    frame = plan.frames[n]
                    place = box[0] + window[0], box[1] + window[1], box[0] + window[2], box[1] + window[3]
                    matrix = self._matrix(frame.taken, place, box, above_mm)
                    around = _around(owned, labels.shape)
                    mine = of_frame[around[1] : around[3], around[0] : around[2]].astype(np.uint8)
                    whole = None if of_frame.all() else mine
                    parts.append(self._part(number, frame, matrix, window, tile_from_cells, around, whole))
        return TileSpec(x1 - x0, y1 - y0, plan.hdr, cells_from_tile[:2], tuple(parts))

    def _matrix(self, taken: TakenFrame, place: Box, box: Box, above_mm: float) -> Floats:
        """Return the matrix from pixels of the tile `box` to raw pixels of a frame, which is right in `place`."""
        matrix = self._projector.matrix(taken.camera, taken.row, self.grid.cad_from_mosaic, place, above_mm)
        return of_part(matrix, box[0], box[1])

    def _part(
        self,
        layer: int,
        frame: PlannedFrame,
        matrix: Floats,
        window: Box,
        tile_from_cells: Floats,
        cells: Box,
        mine: NDArray[np.uint8] | None,
    ) -> FramePart:
        plan, (taken, log_gain) = self._plan, frame
        photometry = plan.cameras[taken.camera]
        eye = self._projector.cameras[taken.camera]
        x0, y0, x1, y1 = window
        # Between the cells of one tile the lens matters less to the field than one of its pixels.
        field_from_cells = of_part(between(matrix @ tile_from_cells, FIELD_PX, 1), cells[0], cells[1])
        size = cells[2] - cells[0], cells[3] - cells[1]
        field = cv2.warpPerspective(
            photometry.field, field_from_cells, size, flags=_LINEAR, borderMode=cv2.BORDER_REPLICATE
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
            cells,
            np.asarray(np.float32(scale) / field, np.float32),
            mine,
            window,
            np.array(limits),
            photometry.dark,
            taken.gain,
            photometry.noise,
            photometry.white_balance,
        )


class _Bodies(NamedTuple):
    """The n bodies of a plan that are shown in the planes of their tops on one grid, the highest last."""

    corners: Floats
    """(n, 4, 2) corners of their footprints, pixels of the grid."""
    height_mm: Floats
    """(n,)"""


def _displaced(plan: MosaicPlan, projector: FrameIndex, grid: MosaicGrid) -> _Bodies:
    """Return the bodies of a plan that are larger than a pixel of the grid, and displaced in it by their heights."""
    corners = np.array([body.corners for body in plan.bodies], np.float64).reshape(-1, 4, 2)
    height_mm = np.array([body.height_mm for body in plan.bodies], np.float64)
    corners = apply(grid.mosaic_from_cad, corners)
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 3] - corners[:, 0]).T
    area = np.abs(ax * by - ay * bx)
    lean = max((projector.largest_lean(camera) for camera in plan.cameras), default=0.0)
    shown = (area >= 1) & (height_mm * lean * grid.px_per_mm >= _STILL_PX)
    return _Bodies(corners[shown], height_mm[shown])


def _around(owned: Box, shape: tuple[int, ...]) -> Box:
    """Return a box of cells with one more cell on each side, as far as there are (rows and columns of all cells).

    Where the frame still has a weight, factors and weights are interpolated between its cells and their neighbours.
    """
    return (
        max(owned[0] - 1, 0),
        max(owned[1] - 1, 0),
        min(owned[2] + 1, shape[1]),
        min(owned[3] + 1, shape[0]),
    )


def _window(owned: Box, shape: tuple[int, ...], tile_from_cells: Floats, size: tuple[int, int]) -> Box:
    """Return the part of a tile of this width and height in which cells have a weight; may be empty."""
    ends = []
    for axis in range(2):
        # The weight of a cell is 0 at the centres of its neighbours and beyond.
        scale, shift = float(tile_from_cells[axis, axis]), float(tile_from_cells[axis, 2])
        first, last = math.floor(scale * (owned[axis] - 1) + shift) + 1, math.ceil(scale * owned[axis + 2] + shift)
        ends.append(
            (
                max(first, 0) if owned[axis] > 0 else 0,
                min(last, size[axis]) if owned[axis + 2] < shape[1 - axis] else size[axis],
            )
        )
    return ends[0][0], ends[1][0], ends[0][1], ends[1][1]


def _crop(low: Sequence[float], high: Sequence[float], size: tuple[int, int], reduction: int) -> Box:
    """Return the part of a frame around raw positions from `low` to `high`, to be averaged over blocks of pixels."""
    # Plain numbers: numpy takes ten times as long for vectors of two, and there are several parts in each tile.
    border, ends = _BORDER_PX * reduction, []
    for a, b, most in zip(low, high, size, strict=True):
        first = max(math.floor(min(max(0.0, a), most)) - border, 0) // reduction * reduction
        last = math.ceil(min(max(0.0, b), most)) + border
        ends.append((first, min(first + -(-(last - first) // reduction) * reduction, most)))
    return ends[0][0], ends[1][0], ends[0][1], ends[1][1]
