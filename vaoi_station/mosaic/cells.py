"""The cells of a mosaic: which frames show each, how well frames agree there, and where bodies stand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry import apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Stitch
from vaoi_station.mosaic.frames import TakenFrame
from vaoi_station.mosaic.gains import Gains, log_field_at
from vaoi_station.mosaic.grid import MosaicGrid
from vaoi_station.mosaic.projection import FrameProjector
from vaoi_station.mosaic.seams import NO_FRAME, FrameCells, Labels
from vaoi_station.mosaic.survey import COARSE_PX, Floats32, SurveyedFrame
from vaoi_station.steps import Steps

CELL_PX = 16
"""Side of a cell in pixels of the mosaic at the resolution of the cameras; seams are blended over this width."""
_NODE_CELLS = 4
"""Distance of the cells that are projected exactly; others are interpolated, within 0.05 px: lenses bend so little."""
_WHOLE_PX = 24.0
"""Distance of a cell's centre from the frame's border with which the cell and its blending lie in the frame."""
_AROUND_MM = 0.4
"""Width of the ground around a body that is taken from the same frame."""
_FLAT_MM = 0.25
"""A body with a smaller height may be cut by a seam."""
_OUTSIDE = 1e3
"""Price in mm for each px by which the centre of a cell lies beside a frame."""
_BODY_COST, _LEAST_COST = 0.05, 0.15
_BAND_CELLS = 16
"""Number of rows of cells that are compared in one step: some milliseconds for the largest boards."""
_NOISE = 0.02
"""Relative difference of frames at which ground still counts as equal."""


@dataclass(frozen=True, eq=False)
class Sight:
    """The cells that one frame shows."""

    x0: int
    y0: int
    inside_px: Floats32
    """(h, w) distance of each cell's centre from the frame's border in px; negative outside."""
    slant_mm: Floats32
    """(h, w) distance of each cell's centre from the foot of the camera, in mm."""

    @property
    def area(self) -> tuple[slice, slice]:
        """The box of cells, as index into the grid of cells."""
        h, w = self.inside_px.shape
        return np.s_[self.y0 : self.y0 + h, self.x0 : self.x0 + w]


def cell_shape(grid: MosaicGrid) -> tuple[int, int]:
    """Return the numbers of rows and columns of cells."""
    return -(-grid.height // CELL_PX), -(-grid.width // CELL_PX)


@compiled
def label_boxes(labels: NDArray[np.int16], count: int) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Find the box (count, 4) x0, y0, x1, y1 that holds the cells of each frame, ends excluded, and their number.

    Args:
        labels: (h, w) number of the frame of each cell, less than `count`; negative for none.
        count: number of frames.
    """
    boxes, counts = np.zeros((count, 4), np.int32), np.zeros(count, np.int64)
    for y in range(labels.shape[0]):
        for x in range(labels.shape[1]):
            n = labels[y, x]
            if n >= 0:
                if counts[n] == 0:
                    boxes[n, 0], boxes[n, 1], boxes[n, 2], boxes[n, 3] = x, y, x + 1, y + 1
                elif x < boxes[n, 0]:
                    boxes[n, 0] = x
                elif x >= boxes[n, 2]:
                    boxes[n, 2] = x + 1
                boxes[n, 3] = y + 1
                counts[n] += 1
    return boxes, counts


def sight_of(frame: TakenFrame, projector: FrameProjector, grid: MosaicGrid) -> Sight:
    """Compute which cells a frame shows, and from which side."""
    x0, y0, x1, y1 = projector.seen_box(frame.camera, frame.row, grid)
    x0, y0 = x0 // CELL_PX, y0 // CELL_PX
    w, h = max(-(-x1 // CELL_PX) - x0, 0), max(-(-y1 // CELL_PX) - y0, 0)
    if not w * h:
        return Sight(x0, y0, *np.zeros((2, h, w), np.float32))
    y, x = np.mgrid[: -(-h // _NODE_CELLS) + 1, : -(-w // _NODE_CELLS) + 1] * _NODE_CELLS
    at = (np.stack([x + x0, y + y0], -1) + 0.5) * CELL_PX - 0.5
    cad = apply(grid.cad_from_mosaic, at)
    places = projector.raw_px(frame.camera, frame.row, cad), projector.from_foot_mm(frame.camera, frame.row, cad)
    nodes_from_cells = np.array([[1 / _NODE_CELLS, 0, 0], [0, 1 / _NODE_CELLS, 0]])
    way = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    spread = cv2.warpAffine(np.concatenate(places, -1).astype(np.float32), nodes_from_cells, (w, h), flags=way)
    raw_x, raw_y, right, down = cv2.split(spread)
    eye = projector.cameras[frame.camera]
    rooms = np.minimum(raw_x, eye.width_px - 1 - raw_x), np.minimum(raw_y, eye.height_px - 1 - raw_y)
    return Sight(x0, y0, np.minimum(*rooms), np.asarray(cv2.magnitude(right, down)))


def frame_cells(sights: Sequence[Sight], cell_mm: float) -> FrameCells:
    """Collect what all frames show, as the growth of seams takes it."""
    box = np.array([(s.x0, s.y0, *s.inside_px.shape[::-1]) for s in sights], np.int32).reshape(-1, 4)
    sizes = box[:, 2].astype(np.int64) * box[:, 3]
    start = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)[: len(sights)]
    shown = np.concatenate([s.inside_px.ravel() >= _WHOLE_PX for s in sights] or [np.zeros(0, bool)])
    seed, delay = np.full((len(sights), 2), -1, np.int32), np.zeros(len(sights))
    for n, s in enumerate(sights):
        slant = np.where(s.inside_px >= _WHOLE_PX, s.slant_mm, np.inf)
        if slant.size and np.isfinite(slant).any():
            v, u = np.unravel_index(int(slant.argmin()), slant.shape)
            seed[n], delay[n] = (s.x0 + u, s.y0 + v), slant[v, u] / cell_mm
    return FrameCells(box, start, shown, seed, delay)


def fill_rest(labels: Labels, sights: Sequence[Sight]) -> Steps[None]:
    """Assign cells that no frame shows wholly to the frame that shows most of them; in place."""
    best = np.full(labels.shape, np.inf, np.float32)
    chosen = np.full(labels.shape, NO_FRAME, np.int32)
    for n, s in enumerate(sights):
        # Half a cell beside the frame: the rest of the cell is in the frame, and the renderer masks what is not.
        price = s.slant_mm + _OUTSIDE * np.maximum(-s.inside_px, 0)
        better = (s.inside_px >= -CELL_PX / 2) & (price < best[s.area])
        best[s.area][better], chosen[s.area][better] = price[better], n
        yield
    rest = labels == NO_FRAME
    labels[rest] = chosen[rest]


def disagreement(
    surveyed: Sequence[SurveyedFrame], gains: Gains, projector: FrameProjector, shape: tuple[int, int]
) -> Steps[Floats32]:
    """Return how much frames differ in each cell (h, w), as a share of the brightness beyond what noise explains."""
    size = tuple(n * (CELL_PX // COARSE_PX) for n in shape)
    low, high = np.full(size, np.inf, np.float32), np.full(size, -np.inf, np.float32)
    for s in surveyed:
        camera, row = s.taken.camera, s.taken.row
        eye = projector.cameras[camera]
        shift = np.array([[1, 0, s.x0], [0, 1, s.y0], [0, 0, 1]], np.float64)
        scale = np.array([[2 / (eye.width_px - 1), 0, -1], [0, 2 / (eye.height_px - 1), -1], [0, 0, 1]])
        frame_from_copy = scale @ s.raw_from_coarse @ shift
        dark, log_gain = gains.dark / s.taken.sensitivity, gains.frame.get((camera, row), 0.0)
        area = np.s_[s.y0 : s.y0 + s.values.shape[0], s.x0 : s.x0 + s.values.shape[1]]
        _widen(s.values, frame_from_copy, gains.coefficients(camera), log_gain, dark, low[area], high[area])
        yield
    found, step = np.empty(shape, np.float32), CELL_PX // COARSE_PX
    # Of a large board the whole takes a quarter of a second, for which callers would wait.
    for y in range(0, shape[0], _BAND_CELLS):
        lowest, highest = (each[y * step : (y + _BAND_CELLS) * step] for each in (low, high))
        with np.errstate(invalid="ignore", divide="ignore"):
            differ = (highest - lowest) / np.maximum(highest + lowest, 1e-9) - np.float32(_NOISE)
        differ = np.nan_to_num(np.clip(differ, 0, 1), nan=0.0)
        found[y : y + _BAND_CELLS] = differ.reshape(-1, step, shape[1], step).max((1, 3))
        yield
    return found


@compiled
def _widen(
    values: Floats32,
    frame_from_copy: Floats,
    coefficients: Floats,
    log_gain: float,
    dark: float,
    low: Floats32,
    high: Floats32,
) -> None:
    """Widen the range `low` … `high` (h, w) of the radiance at each place by that of one frame.

    Args:
        values: radiance in the copy of the frame, at least (h, w); NaN is left out.
        frame_from_copy: (3, 3) matrix from pixels of the copy to places in the frame, whose borders are at −1 and 1.
        coefficients: those of the camera's field.
        log_gain: logarithm of the frame's gain.
        dark: radiance that the dark level pretends.
        low: changed in place.
        high: changed in place.
    """
    m = frame_from_copy
    for y in range(low.shape[0]):
        for x in range(low.shape[1]):
            value = values[y, x]
            if math.isnan(value):
                continue
            w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
            u, v = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / w, (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / w
            corrected = np.float32((value - dark) * math.exp(-log_field_at(u, v, coefficients) - log_gain))
            low[y, x], high[y, x] = min(low[y, x], corrected), max(high[y, x], corrected)


def crossing_cost(differ: Floats32) -> Floats32:
    """Return the time (h, w) in which a front crosses each cell: short where frames disagree."""
    return np.asarray(np.maximum(1 / (1 + 8 * differ), _LEAST_COST), np.float32)


def lock_bodies(
    board_type: BoardType, stitch: Stitch, sights: Sequence[Sight], grid: MosaicGrid, cost: Floats32
) -> Steps[Labels]:
    """Assign the cells of each body to the frame that shows all of it most vertically: (h, w) labels.

    A body that no frame shows wholly is not assigned; fronts cross it quickly, so that seams avoid it (`cost`, changed
    in place).
    """
    labels = np.full(cost.shape, NO_FRAME, np.int32)
    heights = stitch.quality.get("heights_mm", {})
    heights = heights if isinstance(heights, dict) else {}
    near = np.full(cost.shape, np.inf, np.float32)
    boxes = np.array([(s.x0, s.y0, s.x0 + s.inside_px.shape[1], s.y0 + s.inside_px.shape[0]) for s in sights])
    footprints = stitch.footprints(board_type, board_type.components)
    for component, footprint in zip(board_type.components, footprints, strict=True):
        height = component.body_height * board_type.mm_per_unit if component.body_height is not None else None
        measured = heights.get(component.address)
        if isinstance(measured, int | float):
            height = float(measured)
        if height is not None and height < _FLAT_MM:
            continue
        yield
        corners = apply(grid.mosaic_from_cad, footprint)
        around_px = _AROUND_MM * grid.px_per_mm
        low = np.clip(np.floor((corners.min(0) - around_px) / CELL_PX), 0, cost.shape[::-1]).astype(int)
        high = np.clip(np.ceil((corners.max(0) + around_px) / CELL_PX), 0, cost.shape[::-1]).astype(int)
        (x0, y0), (x1, y1) = low.tolist(), high.tolist()
        if x1 <= x0 or y1 <= y0:
            continue
        distance = _distances(corners, x0, y0, np.empty((y1 - y0, x1 - x0), np.float32))
        mask = distance <= around_px + CELL_PX / 2
        if not mask.any():
            continue
        area = np.s_[y0:y1, x0:x1]
        cost[area][mask] = _BODY_COST
        around = np.flatnonzero((boxes[:, :2] <= low).all(1) & (boxes[:, 2:] >= high).all(1))
        best = _best_frame(sights, around.tolist(), (x0, y0), mask)
        if best is not None:
            # Where bodies are close together, the ground between them goes to the nearer one.
            mine = mask & (distance < near[area])
            labels[area][mine] = best
            near[area][mine] = distance[mine]
    return labels


@compiled
def _distances(corners: Floats, x0: int, y0: int, out: Floats32) -> Floats32:
    """Compute the distances (h, w) of the centres of cells from a convex footprint in px; 0 and below inside.

    Args:
        corners: (k, 2) of the footprint, in pixels of the mosaic.
        x0: column of the first cell.
        y0: row of the first cell.
        out: (h, w) is filled and returned.
    """
    count = len(corners)
    middle_x, middle_y = corners[:, 0].mean(), corners[:, 1].mean()
    out[:] = -np.inf
    for k in range(count):
        ax, ay = corners[k, 0], corners[k, 1]
        along_x, along_y = corners[(k + 1) % count, 0] - ax, corners[(k + 1) % count, 1] - ay
        length = max(math.hypot(along_x, along_y), 1e-9)
        nx, ny = along_y / length, -along_x / length
        inward = (ax - middle_x) * nx + (ay - middle_y) * ny
        if inward < 0:
            nx, ny = -nx, -ny
        for y in range(out.shape[0]):
            for x in range(out.shape[1]):
                at_x, at_y = (x + x0) * CELL_PX + (CELL_PX - 1) / 2, (y + y0) * CELL_PX + (CELL_PX - 1) / 2
                out[y, x] = max(out[y, x], (at_x - ax) * nx + (at_y - ay) * ny)
    return out


def _best_frame(
    sights: Sequence[Sight], candidates: Sequence[int], first: tuple[int, int], mask: NDArray[np.bool_]
) -> int | None:
    """Return the frame that shows all cells of a patch and sees them most vertically; None if no frame shows all.

    `candidates` are the frames whose boxes contain the patch.
    """
    h, w = mask.shape
    best, least = None, np.inf
    for n in candidates:
        s = sights[n]
        x, y = first[0] - s.x0, first[1] - s.y0
        part = np.s_[y : y + h, x : x + w]
        if s.inside_px[part][mask].min() < _WHOLE_PX:
            continue
        slant = float(s.slant_mm[part][mask].mean())
        if slant < least:
            best, least = n, slant
    return best
