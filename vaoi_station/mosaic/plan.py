"""The plan of a mosaic: for each cell of the board the frame that shows it, and for each frame its brightness.

A plan is made once for a run and a choice of frames, from a survey that reads each frame once. It is small: one number
per cell of 16 px and layer, and one coarse field per camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Stitch
from vaoi_station.model.stitch_result import known_height_mm
from vaoi_station.mosaic.frames import FrameChoice, TakenFrame
from vaoi_station.mosaic.gains import (
    COARSE_PX,
    Copies,
    FieldCache,
    Floats32,
    Gains,
    ReadFrame,
    SurveyedFrame,
    estimate_gains,
    survey,
)
from vaoi_station.mosaic.grid import MosaicGrid
from vaoi_station.photometry import FlatFields, NoiseModel, WhiteBalance
from vaoi_station.steps import Steps

Labels = NDArray[np.int32]
NO_FRAME = -1
"""Label of a cell that no frame shows."""
_ENTRIES_PER_STEP = 20_000
"""Number of entries that are taken in one step, a few milliseconds."""


class FrameCells(NamedTuple):
    """Which cells every frame shows: boxes of cells, and one value per cell of each box."""

    box: NDArray[np.int32]
    """(f, 4) first column and row, width and height of the box of each of f frames."""
    start: NDArray[np.int64]
    """(f,) where the values of each box begin."""
    shown: NDArray[np.bool_]
    """(n,) whether the frame shows the whole cell with its neighbours; row by row, box after box."""
    seed: NDArray[np.int32]
    """(f, 2) column and row of the shown cell that the frame sees most vertically; -1 if it shows none."""
    delay: NDArray[np.float64]
    """(f,) when the front of each frame starts: distance of the seed from the foot of the camera, in cells."""


class _Queue(NamedTuple):
    """Cells that fronts will reach, in buckets of equal width by time.

    No front crosses a cell in less than the width of a bucket. So whatever order the cells of one bucket are taken in,
    none of them is reached earlier from another one, and the result is that of a heap, in a fraction of its time.
    """

    width: float
    """Width of a bucket."""
    top: NDArray[np.int32]
    """The last entry of each bucket, −1 for none. Buckets are used in turn: all that wait lie within their number."""
    below: NDArray[np.int32]
    """The entry below each one in its bucket; of a free one the next that is free."""
    time: NDArray[np.float64]
    cell: NDArray[np.int32]
    label: NDArray[np.int32]
    state: NDArray[np.int64]
    """(4,) number of the present bucket, number of entries that wait, a free entry or −1, number of entries used."""


def assign_cells(frames: FrameCells, cost: NDArray[np.float32], locked: Labels) -> Steps[Labels]:
    """Assign cells to frames: (h, w) numbers of frames, `NO_FRAME` where no frame shows the cell wholly.

    Args:
        frames: the cells that each frame shows.
        cost: (h, w) time to cross a cell; small in bodies and where frames disagree, about 1 elsewhere.
        locked: (h, w) frames of cells that were assigned beforehand, or `NO_FRAME`.
    """
    labels = np.full(cost.shape, NO_FRAME, np.int32)
    earliest = np.full(cost.shape, np.inf)
    # A little less than the shortest time, for the rounding of sums.
    width = 0.999 * float(cost.min())
    furthest = max(1.5 * float(cost.max()), float(frames.delay.max(initial=0.0)))
    # A cell is entered at most once from each of its eight neighbours, and once for each frame that starts there.
    room = 8 * cost.size + len(frames.start) + 1
    queue = _Queue(
        width,
        np.full(int(furthest / width) + 2, -1, np.int32),
        np.empty(room, np.int32),
        np.empty(room, np.float64),
        np.empty(room, np.int32),
        np.empty(room, np.int32),
        np.array([0, 0, -1, 0], np.int64),
    )
    _plant(frames, earliest, queue)
    while queue.state[1]:
        _grow(frames, cost, locked, labels, earliest, queue)
        yield
    left = (labels == NO_FRAME) & (locked != NO_FRAME)
    labels[left] = locked[left]
    return labels


@compiled
def _plant(frames: FrameCells, earliest: NDArray[np.float64], queue: _Queue) -> None:
    """Enter the cell where the front of each frame starts."""
    for f in range(len(frames.start)):
        x, y = frames.seed[f, 0], frames.seed[f, 1]
        if x >= 0 and frames.delay[f] < earliest[y, x]:
            earliest[y, x] = frames.delay[f]
            _enter(queue, frames.delay[f], y * earliest.shape[1] + x, f)


@compiled
def _grow(
    frames: FrameCells,
    cost: NDArray[np.float32],
    locked: Labels,
    labels: Labels,
    earliest: NDArray[np.float64],
    queue: _Queue,
) -> None:
    """Let fronts grow over some cells.

    `earliest` (h, w) is the earliest time at which a front is known to reach each cell.
    """
    width, state = cost.shape[1], queue.state
    taken = 0
    while taken < _ENTRIES_PER_STEP and state[1] > 0:
        bucket = state[0] % len(queue.top)
        entry = queue.top[bucket]
        if entry < 0:
            state[0] += 1
            continue
        taken += 1
        time, cell, f = queue.time[entry], queue.cell[entry], queue.label[entry]
        queue.top[bucket] = queue.below[entry]
        queue.below[entry], state[2] = state[2], entry
        state[1] -= 1
        y, x = cell // width, cell % width
        # An entry that comes later than another one of the same cell is left over.
        if labels[y, x] >= 0 or time > earliest[y, x]:
            continue
        labels[y, x] = f
        bx, by, bw, bh = frames.box[f, 0], frames.box[f, 1], frames.box[f, 2], frames.box[f, 3]
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                u, v = x + dx, y + dy
                # The box of a frame lies within the grid, so this is also the test for the grid's borders.
                if (dx == 0 and dy == 0) or u < bx or v < by or u >= bx + bw or v >= by + bh:
                    continue
                step = 1.4142135 if dx != 0 and dy != 0 else 1.0
                arrival = time + step * 0.5 * (cost[y, x] + cost[v, u])
                # Cells that have a frame were reached earlier.
                if arrival >= earliest[v, u] or not frames.shown[frames.start[f] + (v - by) * bw + u - bx]:
                    continue
                if locked[v, u] < 0 or locked[v, u] == f:
                    earliest[v, u] = arrival
                    _enter(queue, arrival, v * width + u, f)


@inlined
def _enter(queue: _Queue, time: float, cell: int, label: int) -> None:
    state = queue.state
    entry = state[2]
    if entry >= 0:
        state[2] = queue.below[entry]
    else:
        entry = state[3]
        state[3] += 1
    bucket = int(time / queue.width) % len(queue.top)
    queue.time[entry], queue.cell[entry], queue.label[entry] = time, cell, label
    queue.below[entry], queue.top[bucket] = queue.top[bucket], entry
    state[1] += 1


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


def sight_of(frame: TakenFrame, projector: FrameIndex, grid: MosaicGrid) -> Sight:
    """Compute which cells a frame shows, and from which side."""
    x0, y0, x1, y1 = projector.seen_box(frame.camera, frame.row, *grid.place)
    x0, y0 = x0 // CELL_PX, y0 // CELL_PX
    w, h = max(-(-x1 // CELL_PX) - x0, 0), max(-(-y1 // CELL_PX) - y0, 0)
    if not w * h:
        return Sight(x0, y0, *np.zeros((2, h, w), np.float32))
    cad = apply(grid.cad_from_mosaic, (_nodes(w, h) + (x0, y0) + 0.5) * CELL_PX - 0.5)
    places = projector.raw_px(frame.camera, frame.row, cad), projector.from_foot_mm(frame.camera, frame.row, cad)
    raw_x, raw_y, right, down = cv2.split(_spread(np.concatenate(places, -1), (w, h)))
    eye = projector.cameras[frame.camera]
    rooms = np.minimum(raw_x, eye.width_px - 1 - raw_x), np.minimum(raw_y, eye.height_px - 1 - raw_y)
    return Sight(x0, y0, np.minimum(*rooms), np.asarray(cv2.magnitude(right, down)))


def _nodes(w: int, h: int) -> Floats:
    """Return the places (ny, nx, 2) of nodes over a grid of w × h cells, the last ones beyond its end."""
    y, x = np.mgrid[: -(-h // _NODE_CELLS) + 1, : -(-w // _NODE_CELLS) + 1] * float(_NODE_CELLS)
    return np.stack([x, y], -1)


def _spread(values: Floats, size: tuple[int, int]) -> NDArray[Any]:
    """Interpolate values (ny, nx) or (ny, nx, k) of `_nodes` over all cells of a grid of this width and height."""
    nodes_from_cells = np.array([[1 / _NODE_CELLS, 0, 0], [0, 1 / _NODE_CELLS, 0]])
    way = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(values.astype(np.float32), nodes_from_cells, size, flags=way))


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
    surveyed: Sequence[SurveyedFrame], gains: Gains, projector: FrameIndex, shape: tuple[int, int]
) -> Steps[Floats32]:
    """Return how much frames differ in each cell (h, w), as a share of the brightness beyond what noise explains."""
    size = tuple(n * (CELL_PX // COARSE_PX) for n in shape)
    low, high = np.full(size, np.inf, np.float32), np.full(size, -np.inf, np.float32)
    for s in surveyed:
        camera, (h, w) = s.taken.camera, s.values.shape
        raw_px = apply(s.raw_from_coarse, _nodes(w, h) + (s.x0, s.y0))
        log = _spread(gains.log_field(camera, projector.cameras[camera], raw_px), (w, h))
        log += np.float32(gains.frame.get((camera, s.taken.row), 0.0))
        corrected = (s.values - np.float32(gains.dark / s.taken.sensitivity)) * np.exp(-log)
        area = np.s_[s.y0 : s.y0 + h, s.x0 : s.x0 + w]
        low_there, high_there = low[area], high[area]
        shown = corrected[: low_there.shape[0], : low_there.shape[1]]
        np.fmin(low_there, shown, out=low_there)
        np.fmax(high_there, shown, out=high_there)
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
        distance = _distances(corners, (x0, y0, x1, y1))
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


def _distances(corners: Floats, box: tuple[int, int, int, int]) -> Floats32:
    """Return the distances (h, w) of the centres of a box of cells from a convex footprint in px; negative inside.

    `corners` (k, 2) are those of the footprint, in pixels of the mosaic.
    """
    along = np.roll(corners, -1, axis=0) - corners
    normal = np.stack([along[:, 1], -along[:, 0]], -1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    normal *= np.where(((corners - corners.mean(0)) * normal).sum(1) < 0, -1.0, 1.0)[:, None]
    x, y = (np.arange(first, end) * CELL_PX + (CELL_PX - 1) / 2 for first, end in zip(box[:2], box[2:], strict=True))
    sides = zip(normal.tolist(), (corners * normal).sum(1).tolist(), strict=True)
    found = np.max([nx * x + ny * y[:, None] - offset for (nx, ny), offset in sides], axis=0)
    return np.asarray(found, dtype=np.float32)


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


FIELD_PX = 16
"""Side of a pixel of a camera's field, in pixels of its frames."""
_TONE_PERCENTILES = (0.5, 99.8)


class PlannedFrame(NamedTuple):
    """A frame of a plan, with the logarithm of its gain."""

    taken: TakenFrame
    log_gain: float


class RaisedBody(NamedTuple):
    """A body whose top is shown in its own plane."""

    corners: Floats
    """(4, 2) corners of its footprint where it lies, CAD coordinates of this place by C."""
    height_mm: float


class CameraPhotometry(NamedTuple):
    """What turns grey levels of one camera into those of the mosaic."""

    field: Floats32
    """(h, w) flat field times the estimated field, one value for each `FIELD_PX` px of the frame."""
    dark: float
    """Dark level, 8-bit grey levels."""
    noise: NoiseModel
    white_balance: WhiteBalance | None = None


@dataclass(frozen=True, eq=False)
class MosaicPlan:
    """Which frame shows each cell, and how bright each frame is."""

    base: MosaicGrid
    """The grid at the resolution of the cameras; cells are counted on it."""
    light: str | None
    hdr: bool
    reference_us: float
    """Sensitivity (exposure times gain) to which grey levels are converted without HDR."""
    frames: tuple[PlannedFrame, ...]
    layers: tuple[NDArray[np.int16], ...]
    """Of each layer the number of the frame that shows each cell (h, w); `NO_FRAME` where none does."""
    cameras: dict[int, CameraPhotometry]
    tone: tuple[float, float]
    """Radiance of the darkest and the brightest places, for display."""
    bodies: tuple[RaisedBody, ...] = ()
    """With HDR, the bodies of known height, the highest last: the layers show them from different frames."""

    @property
    def covered(self) -> float:
        """Share of the cells that some frame shows."""
        seen = np.zeros(self.layers[0].shape, bool)
        for layer in self.layers:
            seen |= layer != NO_FRAME
        return float(seen.mean())


def make_plan(
    choice: FrameChoice,
    read: ReadFrame,
    *,
    projector: FrameIndex,
    board_type: BoardType,
    stitch: Stitch,
    base: MosaicGrid,
    fields: FlatFields | None = None,
    copies: Copies | None = None,
) -> Steps[MosaicPlan]:
    """Survey the frames of a run and plan its mosaic, in steps of some milliseconds.

    `base` is the grid at the resolution of the cameras. `copies` gets the reduced frames of the survey.
    """
    known = fields if fields is not None else FlatFields.none()
    cache = FieldCache(known)
    placed = [f for f in choice.frames if projector.places(f.camera, f.row)]
    surveyed: list[SurveyedFrame] = []
    for frame in survey(placed, read, projector, base, cache, copies):
        surveyed.append(frame)
        yield
    gains = yield from estimate_gains(surveyed, projector.cameras, calibrated=bool(known))
    index = {(s.taken.camera, s.taken.row): n for n, s in enumerate(surveyed)}
    differ = yield from disagreement(surveyed, gains, projector, cell_shape(base))
    layers = []
    for layer in choice.layers:
        numbers, sights = [index[f.camera, f.row] for f in layer if (f.camera, f.row) in index], []
        for n in numbers:
            sights.append(sight_of(surveyed[n].taken, projector, base))
            yield
        labels = yield from _labels(numbers, sights, differ.copy(), board_type, stitch, base)
        layers.append(labels)
    cameras = {
        camera: _photometry(camera, choice.light, projector, cache, known, gains)
        for camera in sorted({f.camera for f in placed})
    }
    frames = tuple(PlannedFrame(s.taken, gains.frame[s.taken.camera, s.taken.row]) for s in surveyed)
    reference = max((f.sensitivity for f in choice.frames), default=1.0)
    bodies = _raised_bodies(board_type, stitch) if choice.hdr else ()
    return MosaicPlan(
        base, choice.light, choice.hdr, reference, frames, tuple(layers), cameras, _tone(surveyed, gains.dark), bodies
    )


def _raised_bodies(board_type: BoardType, stitch: Stitch) -> tuple[RaisedBody, ...]:
    heights = ((c, known_height_mm(c, board_type, stitch)) for c in board_type.components)
    raised = [(c, height_mm) for c, height_mm in heights if height_mm]
    footprints = stitch.footprints(board_type, [c for c, _ in raised])
    found = (RaisedBody(corners, height_mm) for (_, height_mm), corners in zip(raised, footprints, strict=True))
    return tuple(sorted(found, key=lambda body: body.height_mm))


def _labels(
    numbers: Sequence[int],
    sights: Sequence[Sight],
    differ: Floats32,
    board_type: BoardType,
    stitch: Stitch,
    base: MosaicGrid,
) -> Steps[NDArray[np.int16]]:
    """Assign each cell of one layer to a frame; `numbers` are the numbers of the layer's frames in the plan."""
    if not sights:
        return np.full(differ.shape, NO_FRAME, np.int16)
    cost = crossing_cost(differ)
    locked = yield from lock_bodies(board_type, stitch, sights, base, cost)
    labels = yield from assign_cells(frame_cells(sights, CELL_PX / base.px_per_mm), cost, locked)
    yield from fill_rest(labels, sights)
    known = np.array([*numbers, NO_FRAME], np.int16)
    return known[labels]


def _photometry(
    camera: int, light: str | None, projector: FrameIndex, cache: FieldCache, known: FlatFields, gains: Gains
) -> CameraPhotometry:
    eye = projector.cameras[camera]
    w, h = (-(-n // FIELD_PX) for n in (eye.width_px, eye.height_px))
    y, x = np.mgrid[:h, :w] * float(FIELD_PX) + (FIELD_PX - 1) / 2
    field = np.exp(gains.log_field(camera, eye, np.stack([x, y], -1))).astype(np.float32)
    flat, dark = cache.reduced(camera, light, FIELD_PX)
    if not isinstance(flat, float):
        # The reduced field lacks what is left of the last block; it continues with its last value.
        fh, fw = flat.shape
        field *= np.pad(flat, ((0, h - fh), (0, w - fw)), mode="edge")
    level = float(np.mean(dark)) + gains.dark
    balance = known.white_balances.get((camera, light))
    return CameraPhotometry(field, level, known.maps(camera, light).noise, balance)


def _tone(surveyed: Sequence[SurveyedFrame], dark: float) -> tuple[float, float]:
    """Return a low and a high percentile of the radiance of all frames."""
    values = [(s.values[::2, ::2] - dark / s.taken.sensitivity).ravel() for s in surveyed]
    found = np.concatenate(values) if values else np.zeros(0, np.float32)
    found = found[np.isfinite(found)]
    if not len(found):
        return 1e-6, 1.0
    low, high = np.percentile(found, _TONE_PERCENTILES)
    high = max(float(high), 1e-9)
    return max(float(low), 1e-4 * high), high
