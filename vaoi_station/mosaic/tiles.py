"""Pixels of any part of a mosaic, rendered from the frames that show it.

Without HDR, grey levels are those of the frames after correction: dark level subtracted, divided by the field of the
camera and the gain of the frame. Two frames meet at a seam with weights that change over one cell (16 px of the
cameras). With HDR each layer gives radiance and its noise, and the layers are merged by their noise.

On reduced levels saturation is decided by the pixels of the frames: the mean of a block with saturated pixels is too
dark, although it is not saturated itself. A layer without such pixels takes its place. If there is none, the shortest
exposure gives the value, which is a lower bound there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.geometry.polygon import pixels_inside
from vaoi_station.geometry.shifting import shift
from vaoi_station.geometry.transforms import Floats
from vaoi_station.mosaic.blending import Cells, Nodes, Pictures, blend, nodes_along
from vaoi_station.mosaic.projection import between
from vaoi_station.mosaic.reduction import BORDER_PX, Reduced, ReducedFrames, reduced
from vaoi_station.mosaic.survey import Floats32, ReadFrame
from vaoi_station.mosaic.tile_specs import Box, FramePart, TileSpec
from vaoi_station.photometry import Radiance, merge
from vaoi_station.photometry.radiance import is_saturated, pixels_at_limit

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
            moved = matrix.copy()
            moved[:, 2] += x0 * matrix[:, 0] + y0 * matrix[:, 1]
            w, h = x1 - x0, y1 - y0
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
        matrix = _moved(source.matrix, box)
        signal = cv2.warpPerspective(_grey_levels(source.pixels), matrix, size, flags=_LINEAR) - np.float32(part.dark)
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
    value = merge([_mean(total) for total in totals.values()]).value
    # The last layer is that of the shortest exposure.
    for _, total in sorted(clipped.items(), reverse=True):
        value = np.where(np.isnan(value), _mean(total).value, value)
    return value


def _mean(total: Floats32) -> Radiance:
    """Return the radiance of one layer from its sums (3, h, w): of values, of their noise and of the weights."""
    value, noise, weights = total
    valid = weights > 1e-3
    share = np.where(valid, weights, np.float32(1))
    mean = np.where(valid, value / share, np.float32(np.nan))
    return Radiance(mean, np.where(valid, noise / share, np.float32(np.inf)), valid)


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
    matrix = part.raw_from_tile.copy()
    matrix[:2] -= np.array([(x0, y0)]).T * matrix[2]
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


def _moved(matrix: Floats, box: Box) -> Floats:
    """Return the matrix (2 or 3, 3) from pixels of a part of a tile for one from pixels of the tile."""
    moved = matrix.copy()
    moved[:, 2] += box[0] * matrix[:, 0] + box[1] * matrix[:, 1]
    return moved


def _spread(values: NDArray[Any], part: FramePart, spec: TileSpec, box: Box) -> Floats32:
    """Interpolate values (h, w) of the cells of a part over the pixels of a box of the tile."""
    cells_from_box = _moved(spec.cells_from_tile, box)
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
    m = _moved(part.raw_from_tile, box)
    x, y = np.arange(width), np.arange(height)[:, None]
    for border, limit in enumerate(part.limits.tolist()):
        axis, sign = border % 2, 1.0 if border < 2 else -1.0
        # A pixel is inside if the nearest one of the frame is.
        a, b, c = sign * (m[axis] - (limit - 0.5 * sign) * m[2])
        weight[a * x + b * y + c < 0] = 0
    return weight


def _grey_levels(pixels: NDArray[Any]) -> Floats32:
    grey = pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY))
    return np.asarray(grey, np.float32) * np.float32(1.0 if grey.dtype == np.uint8 else 255 / 65535)
