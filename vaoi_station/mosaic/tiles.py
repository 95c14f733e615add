"""Pixels of any part of a mosaic, rendered from the frames that show it.

Without HDR, grey levels are those of the frames after correction: dark level subtracted, divided by the field of the
camera and the gain of the frame. Two frames meet at a seam with weights that change over one cell (16 px of the
cameras). With HDR each layer gives radiance and its noise, and the layers are merged by their noise.

On reduced levels saturation is decided by the pixels of the frames: the mean of a block with saturated pixels is too
dark, although it is not saturated itself. A layer without such pixels takes its place. If there is none, the shortest
exposure gives the value, which is a lower bound there.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.errors import InputError
from vaoi_station.files.pyramids import TILE_PX, PyramidLayout, write_pyramid
from vaoi_station.frame_index import Box, FrameIndex
from vaoi_station.geometry.homographies import between, of_part, to_part
from vaoi_station.geometry.polygon import pixels_inside
from vaoi_station.geometry.shifting import shift
from vaoi_station.geometry.transforms import Floats
from vaoi_station.mosaic.gains import Floats32, ReadFrame
from vaoi_station.mosaic.grid import MosaicGrid
from vaoi_station.mosaic.plan import MosaicPlan
from vaoi_station.mosaic.reduction import BORDER_PX, Reduced, ReducedFrames, reduced
from vaoi_station.mosaic.tile_specs import FramePart, TileRenderer, TileSpec
from vaoi_station.photometry.noise import grey_levels, is_saturated, pixels_at_limit
from vaoi_station.version import __version__

_NO_PART = -1
_SEVERAL = -2


class Nodes(NamedTuple):
    """Where the pixels of a tile lie between the centres of cells, along one axis."""

    cell: NDArray[np.int32]
    """(n,) the cell before each pixel; the next one exists."""
    share: Floats32
    """(n,) weight of the next cell."""


class Cells(NamedTuple):
    """What each cell (h, w) of a tile shows."""

    part: NDArray[np.int32]
    """Number of the frame among those of the tile; −1 for none."""
    factor: Floats32
    """What grey levels of this frame are multiplied by here."""


class Pictures(NamedTuple):
    """The frames of a tile, resampled where they have a weight."""

    pixels: NDArray[Any]
    """(n,) grey levels of all frames, one rectangle after the other, of the tile's type and channels."""
    place: NDArray[np.int64]
    """(frames, 4) of each frame: where in `pixels` its rectangle starts; left, top and width of it, px of the tile."""
    dark: Floats32
    """(frames,) dark level."""
    raw_from_tile: Floats
    """(frames, 3, 3) matrices from pixels of the tile to raw pixels of the frame."""
    limits: Floats
    """(frames, 4) least x and y, largest x and y of raw pixels that count as inside."""


class _Sums(NamedTuple):
    """Sums over the cells around each value of a line, (n,)."""

    total: Floats32
    """Σ weight · (grey − dark) · factor."""
    weight: Floats32
    """Σ weight."""


def nodes_along(first: float, step: float, count: int, cells: int) -> Nodes:
    """Return the place of `count` pixels, the first at cell position `first`, among the centres of `cells` cells."""
    at = np.clip(first + step * np.arange(count), 0, max(cells - 1, 0))
    cell = np.minimum(np.floor(at).astype(np.int32), max(cells - 2, 0)).astype(np.int32)
    return Nodes(cell, (at - cell).astype(np.float32))


@inlined
def _inside(m: Floats, limits: Floats, v: int, width: int) -> tuple[int, int]:
    """Return the first pixel of line v that lies inside the frame, and the one after the last: it is convex."""
    first, end = 0.0, float(width)
    # a · s + b ≥ 0 for each border of the frame: raw x − least · w, largest · w − raw x, and the same for y.
    for border in range(4):
        axis, sign = border % 2, 1.0 if border < 2 else -1.0
        a = sign * (m[axis, 0] - limits[border] * m[2, 0])
        b = sign * (m[axis, 1] * v + m[axis, 2] - limits[border] * (m[2, 1] * v + m[2, 2]))
        if a > 0:
            first = max(first, np.ceil(-b / a))
        elif a < 0:
            end = min(end, np.floor(-b / a) + 1)
        elif b < 0:
            end = first
    return int(min(first, float(width))), int(max(end, 0.0))


@inlined
def _lines_inside(pictures: Pictures, width: int, height: int, channels: int) -> NDArray[np.int64]:
    """Return of each frame and line (frames, height, 2) the first value inside the frame, and the end of those."""
    count = len(pictures.dark)
    spans = np.empty((count, height, 2), np.int64)
    for p in range(count):
        for v in range(height):
            first, end = _inside(pictures.raw_from_tile[p], pictures.limits[p], v, width)
            spans[p, v, 0], spans[p, v, 1] = first * channels, end * channels
    return spans


@inlined
def _mix(
    pictures: Pictures,
    cells: Cells,
    x: Nodes,
    y: Nodes,
    spans: NDArray[np.int64],
    at: tuple[int, int, int],
    channels: int,
    sums: _Sums,
) -> None:
    """Write the sums over four cells of several frames.

    `at` is the line, the number of the first value in it, and that after the last. All lie between the same four cells.
    """
    v, left, right = at
    rows, columns = cells.part.shape
    for s in range(left, right):
        sums.total[s] = sums.weight[s] = 0
    for corner in range(4):
        r, c = min(y.cell[v] + corner // 2, rows - 1), min(x.cell[left] + corner % 2, columns - 1)
        p = cells.part[r, c]
        if p >= 0:
            down = y.share[v] if corner >= 2 else np.float32(1) - y.share[v]
            # The weight along the line is offset + slope · share.
            offset, slope = (np.float32(0), down) if corner % 2 == 1 else (down, -down)
            factor, dark = cells.factor[r, c], pictures.dark[p]
            first, end = max(left, spans[p, v, 0]), min(right, spans[p, v, 1])
            before, top, width = pictures.place[p, 1], pictures.place[p, 2], pictures.place[p, 3]
            start = np.uint64(pictures.place[p, 0] + ((v - top) * width - before) * channels + first)
            # Unsigned numbers, because the compiler uses vector registers only if no index can be negative.
            for n in range(max(end - first, 0)):
                at_value = np.uint64(first) + np.uint64(n)
                weight = offset + slope * x.share[at_value]
                sums.total[at_value] += weight * factor * (np.float32(pictures.pixels[start + np.uint64(n)]) - dark)
                sums.weight[at_value] += weight


@compiled
def blend(pictures: Pictures, cells: Cells, x: Nodes, y: Nodes, channels: int, full: float, out: NDArray[Any]) -> None:
    """Render a tile: Σ weight · (grey − dark) · factor / Σ weight over the four cells around each pixel.

    Values are rounded to whole grey levels from 1 to `full`; 0 where no frame has a weight.

    Args:
        pictures: the frames.
        cells: the cells of the tile.
        x: places of the pixels of a line; each is repeated for every channel.
        y: places of the lines.
        channels: 1 grey, 3 colour.
        full: the largest grey level.
        out: (h, w · channels) output.
    """
    # Most pixels lie between four cells of one frame. Runs of them are one loop over contiguous arrays, for which the
    # compiler uses vector registers. Between cells of several frames, a run ends at the next cell.
    height, width = out.shape
    part, factor = cells
    rows, columns = part.shape
    pixels, place, dark, _, _ = pictures
    spans = _lines_inside(pictures, width // channels, height, channels)
    one, half, most, least = np.float32(1), np.float32(0.5), np.float32(full), np.float32(1e-6)
    above, below = np.empty(width, np.float32), np.empty(width, np.float32)
    sums = _Sums(np.empty(width, np.float32), np.empty(width, np.float32))
    starts, owners = np.empty(width + 1, np.int64), np.empty(width, np.int64)
    runs, row = 0, -1
    for v in range(height):
        j, q = y.cell[v], y.share[v]
        k = min(j + 1, rows - 1)
        if j != row:
            row, runs = j, 0
            for s in range(width):
                i, t = x.cell[s], x.share[s]
                n = min(i + 1, columns - 1)
                above[s] = factor[j, i] + t * (factor[j, n] - factor[j, i])
                below[s] = factor[k, i] + t * (factor[k, n] - factor[k, i])
                p = part[j, i]
                owner = p if part[j, n] == p and part[k, i] == p and part[k, n] == p else _SEVERAL
                changed = runs == 0 or owners[runs - 1] != owner
                if changed or (owner == _SEVERAL and x.cell[s] != x.cell[s - 1]):
                    starts[runs], owners[runs] = s, owner
                    runs += 1
            starts[runs] = width
        for run in range(runs):
            left, right, owner = starts[run], starts[run + 1], owners[run]
            if owner == _NO_PART:
                out[v, left:right] = 0
            elif owner == _SEVERAL:
                _mix(pictures, cells, x, y, spans, (v, left, right), channels, sums)
                for s in range(left, right):
                    value = max(sums.total[s] / max(sums.weight[s], least), half) + half
                    out[v, s] = np.int32(min(value, most)) if sums.weight[s] > least else 0
            else:
                first = min(max(left, spans[owner, v, 0]), right)
                end = max(min(right, spans[owner, v, 1]), first)
                out[v, left:first] = 0
                out[v, end:right] = 0
                at = place[owner, 0] + ((v - place[owner, 2]) * place[owner, 3] - place[owner, 1]) * channels + first
                greys, line = pixels[at : at + end - first], out[v, first:end]
                high, low, black = above[first:end], below[first:end], dark[owner]
                for s in range(end - first):
                    value = (high[s] + q * (low[s] - high[s])) * (np.float32(greys[s]) - black) + half
                    line[s] = np.int32(min(max(value, one), most))


Frames = ReadFrame | ReducedFrames
"""The frames of a run. Reduced ones serve tiles that are reduced at least as much."""
NODATA = 0
"""Value of pixels of 8 or 16 bits that no frame shows; shown pixels are at least 1. Floats are NaN there."""
_LINEAR = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
_NEAREST = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
_CALL_PX = 2000
"""Number of pixels that are resampled in the time that a call takes."""


class Scratch:
    """Memory that the parts of one picture are rendered in, one after the other.

    The system clears new memory page by page, which takes a third of the time of a part of a megapixel.
    """

    def __init__(self) -> None:
        self._memory: dict[str, NDArray[np.uint8]] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
        """Return an uninitialised array in the memory of this name: the array before it is overwritten."""
        size = int(np.prod(shape, dtype=int)) * dtype.itemsize
        memory = self._memory.get(name)
        if memory is None or memory.size < size:
            memory = self._memory[name] = np.empty(size, np.uint8)
        return memory[:size].view(dtype).reshape(shape)


def render_tile(spec: TileSpec, frames: Frames, scratch: Scratch | None = None) -> NDArray[Any] | None:
    """Render a tile from its frames; None if no frame shows any of it.

    Returns pixels (h, w) or (h, w, 3) of the type of the frames; with HDR radiance (h, w), float32. With `scratch`, the
    pixels are valid until the next tile is rendered in it.

    Raises:
        InputError: frames differ in pixel type or number of channels.
    """
    memory = Scratch() if scratch is None else scratch
    if spec.hdr:
        return _with_bodies(_render_hdr(spec, frames), spec, frames)
    sources = [(part, _source(part, frames, whole=True)) for part in spec.parts]
    found = [(part, source.pixels, source.matrix) for part, source in sources if source is not None]
    if not found:
        return None
    first = found[0][1]
    _refuse_different_formats([frame for _, frame, _ in found])
    channels = 1 if first.ndim == 2 else first.shape[2]
    cells = _cells([part for part, _, _ in found], spec.cell_shape)
    m = spec.cells_from_tile
    x = nodes_along(m[0, 2], m[0, 0], spec.width, cells.part.shape[1])
    y = nodes_along(m[1, 2], m[1, 1], spec.height, cells.part.shape[0])
    pictures = _resampled(found, spec.cell_shape, x, y, memory)
    out = memory.array("tile", (spec.height, spec.width * channels), first.dtype)
    every = x if channels == 1 else Nodes(np.repeat(x.cell, channels), np.repeat(x.share, channels))
    blend(pictures, cells, every, y, channels, 255.0 if first.dtype == np.uint8 else 65535.0, out)
    if not out.any():
        return None
    return out if channels == 1 else out.reshape(spec.height, spec.width, channels)


def load() -> None:
    """Load the compiled functions, so that their first calls take no longer than others."""
    pixels, nodes = np.ones((4, 4), np.uint8), nodes_along(0.0, 0.25, 4, 2)
    for factor in (2, 32):  # with sums of 16 and of 32 bits
        reduced(Reduced(pixels, pixels), factor)
    place, limits = np.array([[0, 0, 0, 4]]), np.array([[0.0, 0.0, 9.0, 9.0]])
    pictures = Pictures(pixels.ravel(), place, np.ones(1, np.float32), np.eye(3)[None], limits)
    cells = Cells(np.zeros((2, 2), np.int32), np.ones((2, 2), np.float32))
    blend(pictures, cells, nodes, nodes, 1, 255.0, np.empty_like(pixels))
    shown = pixels.view()
    shown.flags.writeable = False
    shift(shown, np.eye(3)[None], 1, pixels.ravel(), np.array([[0, 4, 4, 4]]), False)


def _refuse_different_formats(frames: Sequence[NDArray[Any]]) -> None:
    """Refuse frames of which one would be read as if it had the pixels of another."""
    formats = {(frame.dtype, frame.shape[2:]): None for frame in frames}
    if len(formats) > 1:
        names = ", ".join(f"{d.itemsize * 8} bits {'in colour' if channels else 'grey'}" for d, channels in formats)
        raise InputError(
            f"The cameras of this mosaic have different pixel formats ({names}).",
            action="Give all cameras the same pixel_format.",
        )


def _cells(parts: Sequence[FramePart], shape: tuple[int, int]) -> Cells:
    """Return which of these parts each cell of a tile (rows and columns) shows, and its factor."""
    number, factor = np.full(shape, -1, np.int32), np.ones(shape, np.float32)
    for n, part in enumerate(parts):
        mine = True if part.mine is None else part.mine.view(bool)
        x0, y0, x1, y1 = part.cells
        np.copyto(number[y0:y1, x0:x1], n, where=mine)
        np.copyto(factor[y0:y1, x0:x1], part.factor, where=mine)
    return Cells(number, factor)


def _resampled(
    found: Sequence[tuple[FramePart, NDArray[Any], Floats]],
    shape: tuple[int, int],
    x: Nodes,
    y: Nodes,
    memory: Scratch,
) -> Pictures:
    """Resample the frames of a tile where they have a weight.

    Args:
        found: the parts with their sources (`_source`).
        shape: numbers of rows and columns of cells of the tile.
        x: places of the pixels of a line among the cells.
        y: places of the lines.
        memory: memory for the pixels.
    """
    rows, columns = shape
    # Where the pixels begin that lie after the centre of a cell, from the one before the first to the one after the
    # last.
    lefts = np.searchsorted(x.cell, np.arange(-1, columns + 1)).tolist()
    tops = np.searchsorted(y.cell, np.arange(rows + 1)).tolist()
    # A part may have its cells beside the tile, and no pixel between their centres.
    windows = [
        _windows(part.mine, lefts[part.cells[0] : part.cells[2] + 2], tops[part.cells[1] : part.cells[3] + 1])
        or [(0, 0, 0, 0)]
        for part, _, _ in found
    ]
    place, size = np.zeros((len(found), 4), np.int64), 0
    channels = found[0][1].shape[2:]
    depth = int(np.prod(channels, dtype=int))
    for n, boxes in enumerate(windows):
        left, right = min(box[0] for box in boxes), max(box[2] for box in boxes)
        top, bottom = boxes[0][1], boxes[-1][3]
        place[n] = size * depth, left, top, right - left
        size += (right - left) * (bottom - top)
    pixels = memory.array("frames", (size * depth,), found[0][1].dtype)
    for (_, frame, matrix), boxes, (start, left, top, width) in zip(found, windows, place.tolist(), strict=True):
        height = boxes[-1][3] - top
        area = pixels[start : start + width * height * depth].reshape(height, width, *channels)
        lines = frame.reshape(len(frame), -1).view()
        # Numba compiles separate versions for writeable and read-only arrays, so all frames are passed as read-only.
        lines.flags.writeable = False
        # OpenCV takes a size of 0 for that of the source.
        for x0, y0, x1, y1 in boxes if area.size else ():
            moved, w, h = of_part(matrix, x0, y0), x1 - x0, y1 - y0
            goal = np.array([[start // depth + (y0 - top) * width + x0 - left, width, w, h]])
            if not shift(lines, moved[None], depth, pixels, goal, False)[0]:
                shown = area[y0 - top : y1 - top, x0 - left : x1 - left]
                cv2.warpPerspective(frame, moved, (w, h), dst=shown, flags=_LINEAR)
    parts, unit = [part for part, _, _ in found], 1.0 if pixels.dtype == np.uint8 else 257.0
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
        mine: (h, w) 1 for cells of the frame, of the part of the tile's cells that holds them; None if all are.
        lefts: (w + 2,) the first pixel after the centre of each column of this part, from the column before the first.
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
    return boxes


def _with_bodies(ground: Floats32 | None, spec: TileSpec, frames: Frames) -> Floats32 | None:
    """Replace what footprints hide by the tops of their bodies, which the layers show in one place only there."""
    for first, corners, part in spec.bodies if ground is not None else ():
        top = _render_hdr(part, frames)
        if top is not None and ground is not None:
            shown = pixels_inside(corners, part.width, part.height) & np.isfinite(top)
            ground[first[1] : first[1] + part.height, first[0] : first[0] + part.width][shown] = top[shown]
    return ground


def _render_hdr(spec: TileSpec, frames: Frames) -> Floats32 | None:
    """Render radiance: blend the frames of each layer, then merge the layers by their noise."""
    shape = 3, spec.height, spec.width
    totals: dict[int, Floats32] = {}
    clipped: dict[int, Floats32] = {}
    """The same of blocks of pixels of which some are saturated."""
    for part in spec.parts:
        source = _source(part, frames, whole=False)
        if source is None:
            continue
        # One more pixel on each side: the noise is that of the mean of 3 × 3 px.
        x0, y0, x1, y1 = box = _grown(part.window, spec)
        size = x1 - x0, y1 - y0
        matrix = of_part(source.matrix, x0, y0)
        signal = cv2.warpPerspective(grey_levels(source.pixels), matrix, size, flags=_LINEAR) - np.float32(part.dark)
        factor = _spread(part.factor, part, spec, box)
        sigma = np.sqrt(part.noise.variance(cv2.blur(signal, (3, 3)), part.gain)) * factor
        weight = _weight(part, spec, box)
        saturated = is_saturated(source.pixels).astype(np.uint8)
        if saturated.any():
            weight = weight * (cv2.warpPerspective(saturated, matrix, size, flags=_NEAREST) == 0)
        total = totals.setdefault(part.layer, np.zeros(shape, np.float32))[:, y0:y1, x0:x1]
        partly = _partly_saturated(source, part.reduction)
        if partly is not None:
            touched = cv2.warpPerspective(partly, matrix, size, flags=_LINEAR) > 0
            lost = weight * touched
            rest = clipped.setdefault(part.layer, np.zeros(shape, np.float32))[:, y0:y1, x0:x1]
            rest += (lost * signal * factor, lost * sigma, lost)
            weight = weight - lost
        total += (weight * signal * factor, weight * sigma, weight)
    if not totals:
        return None
    merged, weights = np.zeros((2, *shape[1:]))
    for total in totals.values():
        mean, sigma = _mean(total)
        # Pictures of one place are merged with the inverse of their variance (paper, section 3.5).
        weight = np.where(np.isfinite(mean) & (sigma > 0), 1 / np.square(sigma, dtype=np.float64), 0.0)
        merged += weight * np.nan_to_num(mean)
        weights += weight
    with np.errstate(invalid="ignore"):
        value = (merged / weights).astype(np.float32)
    # The last layer is that of the shortest exposure.
    for _, total in sorted(clipped.items(), reverse=True):
        value = np.where(np.isnan(value), _mean(total)[0], value)
    return value


def _mean(total: Floats32) -> tuple[Floats32, Floats32]:
    """Return radiance and noise of one layer from its sums (3, h, w): of values, of their noise and of the weights."""
    value, noise, weights = total
    valid = weights > 1e-3
    share = np.where(valid, weights, np.float32(1))
    mean = np.where(valid, value / share, np.float32(np.nan))
    return mean, np.where(valid, noise / share, np.float32(np.inf))


def _partly_saturated(source: _Source, reduction: int) -> Floats32 | None:
    """Return where a reduced frame has blocks with a saturated pixel, (h, w) above 0 there; None if it has none."""
    if reduction == 1:
        return None
    at_limit = pixels_at_limit(source.largest)
    return at_limit.astype(np.float32) if at_limit.any() else None


class _Source(NamedTuple):
    """The pixels that a tile is resampled from."""

    pixels: NDArray[Any]
    """C-contiguous."""
    matrix: Floats
    """(3, 3) from pixels of the tile to these pixels."""
    largest: NDArray[Any]
    """The largest pixel of the frame in each of these pixels; `pixels` themselves if the frame is not reduced."""


def _source(part: FramePart, frames: Frames, *, whole: bool) -> _Source | None:
    """Return the pixels that a tile is resampled from: the part of the frame that the tile shows, reduced.

    With `whole`, a frame that is not reduced is not copied. None if the frame is missing or the part is empty.
    """
    found = _picture(part, frames)
    x0, y0, x1, y1 = part.crop
    if found is None or x1 <= x0 or y1 <= y0:
        return None
    picture, unit = found
    if whole and part.reduction == 1:
        return _Source(picture.means, part.raw_from_tile, picture.largest)
    matrix = to_part(part.raw_from_tile, x0, y0)
    shown = picture.part((x0 // unit, y0 // unit, -(-x1 // unit), -(-y1 // unit)))
    if part.reduction == 1:
        pixels = np.ascontiguousarray(shown.means)
        return _Source(pixels, matrix, pixels)
    matrix = between(matrix, part.reduction, 1)
    matrix[:2] += BORDER_PX * matrix[2]
    small = reduced(shown, part.reduction // unit).bordered()
    return _Source(small.means, matrix, small.largest)


def _picture(part: FramePart, frames: Frames) -> tuple[Reduced, int] | None:
    """Return the frame of a part, and by how much it is reduced already; None if it is missing."""
    if isinstance(frames, ReducedFrames):
        found = frames.frames.get((part.camera, part.row))
        return None if found is None else (found, frames.factor)
    pixels = frames(part.camera, part.row)
    return None if pixels is None else (Reduced(pixels, pixels), 1)


def _grown(box: Box, spec: TileSpec) -> Box:
    """Return a part of a tile with one more pixel on each side, as far as the tile reaches."""
    x0, y0, x1, y1 = box
    return max(x0 - 1, 0), max(y0 - 1, 0), min(x1 + 1, spec.width), min(y1 + 1, spec.height)


def _spread(values: NDArray[Any], part: FramePart, spec: TileSpec, box: Box) -> Floats32:
    """Interpolate values (h, w) of the cells of a part over the pixels of a box of the tile."""
    cells_from_box = of_part(spec.cells_from_tile, *box[:2])
    cells_from_box[:, 2] -= part.cells[:2]
    size = (box[2] - box[0], box[3] - box[1])
    return np.asarray(
        cv2.warpAffine(values, cells_from_box, size, flags=_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32
    )


def _weight(part: FramePart, spec: TileSpec, box: Box) -> Floats32:
    """Return the weight of a frame at each pixel of a box of the tile."""
    width, height = box[2] - box[0], box[3] - box[1]
    if part.mine is None:
        weight = np.ones((height, width), np.float32)
    else:
        weight = _spread(part.mine.astype(np.float32), part, spec, box)
    if part.wholly:
        return weight
    m = of_part(part.raw_from_tile, *box[:2])
    x, y = np.arange(width), np.arange(height)[:, None]
    for border, limit in enumerate(part.limits.tolist()):
        axis, sign = border % 2, 1.0 if border < 2 else -1.0
        # A pixel is inside if the nearest one of the frame is.
        a, b, c = sign * (m[axis] - (limit - 0.5 * sign) * m[2])
        weight[a * x + b * y + c < 0] = 0
    return weight


CACHE_BYTES = 128_000_000
"""Memory for frames that later tiles may need again."""


class FrameCache:
    """The frames that were read last, up to a number of bytes."""

    def __init__(self, read: ReadFrame, most_bytes: int = CACHE_BYTES) -> None:
        self._read, self._most = read, most_bytes
        self._frames: OrderedDict[tuple[int, int], NDArray[Any] | None] = OrderedDict()
        self._bytes = 0

    def __call__(self, camera: int, row: int) -> NDArray[Any] | None:
        """Return a frame, from memory if it was read lately."""
        key = camera, row
        if key in self._frames:
            self._frames.move_to_end(key)
            return self._frames[key]
        frame = self._frames[key] = self._read(camera, row)
        self._bytes += 0 if frame is None else frame.nbytes
        while self._bytes > self._most and len(self._frames) > 1:
            _, old = self._frames.popitem(last=False)
            self._bytes -= 0 if old is None else old.nbytes
        return frame


def write_mosaic(
    path: Path, plan: MosaicPlan, projector: FrameIndex, grid: MosaicGrid, read: ReadFrame
) -> PyramidLayout:
    """Render a mosaic and write it as a pyramidal TIFF; return what was written. The file appears when complete."""
    cached = FrameCache(read)
    sample = next((f for f in (read(p.taken.camera, p.taken.row) for p in plan.frames) if f is not None), None)
    colour = sample is not None and sample.ndim == 3 and not plan.hdr
    dtype = np.dtype(np.float32) if plan.hdr else np.dtype(np.uint8) if sample is None else sample.dtype
    layout = PyramidLayout(
        grid.width,
        grid.height,
        dtype,
        3 if colour else 1,
        "nan" if plan.hdr else str(NODATA),
        grid.px_per_mm,
        f"vaoi mosaic, vaoi_station {__version__}",
    )
    renderer = TileRenderer(plan, projector, grid)

    columns, rows = (side // TILE_PX for side in renderer.block_px)
    block: NDArray[Any] | None = None
    rendered: tuple[int, int] | None = None
    scratch = Scratch()

    def tile(x: int, y: int) -> NDArray[Any]:
        nonlocal block, rendered
        place = x // columns, y // rows
        if place != rendered:
            rendered = place
            x0, y0 = place[0] * columns * TILE_PX, place[1] * rows * TILE_PX
            x1, y1 = x0 + columns * TILE_PX, y0 + rows * TILE_PX
            box = x0, y0, min(x1, grid.width), min(y1, grid.height)
            block = render_tile(renderer.spec(box), cached, scratch)
        whole = np.full(layout.tile_shape, np.nan if plan.hdr else NODATA, dtype)
        if block is not None:
            left, top = x % columns * TILE_PX, y % rows * TILE_PX
            part = block[top : top + TILE_PX, left : left + TILE_PX]
            # TIFF has the channels in the order red, green, blue; frames have them in that of OpenCV.
            whole[: part.shape[0], : part.shape[1]] = part if part.ndim == 2 else part[..., ::-1]
        return whole

    write_pyramid(path, layout, tile)
    return layout
