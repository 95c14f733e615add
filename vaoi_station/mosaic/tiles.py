"""Pixels of any part of a mosaic, rendered from the frames that show it.

Without HDR, grey levels are those of the frames after correction: dark level subtracted, divided by the field of the
camera and the gain of the frame. Two frames meet at a seam with weights that change over one cell (16 px of the
cameras). With HDR each layer gives radiance and its noise, and the layers are merged by their noise.

On reduced levels saturation is decided by the pixels of the frames: the mean of a block with saturated pixels is too
dark, although it is not saturated itself. A layer without such pixels takes its place. If there is none, the shortest
exposure gives the value, which is a lower bound there.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.errors import InputError
from vaoi_station.files.pyramids import TILE_PX, PyramidLayout, write_pyramid
from vaoi_station.frame_index import Box, FrameIndex
from vaoi_station.geometry.homographies import between, of_part, to_part
from vaoi_station.geometry.polygon import pixels_inside
from vaoi_station.geometry.resampling import resampled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.mosaic.gains import Floats32, ReadFrame
from vaoi_station.mosaic.grid import MosaicGrid
from vaoi_station.mosaic.plan import MosaicPlan
from vaoi_station.mosaic.reduction import BORDER_PX, Reduced, ReducedFrames, reduced
from vaoi_station.mosaic.tile_specs import FramePart, TileRenderer, TileSpec
from vaoi_station.photometry.noise import grey_levels, is_saturated, pixels_at_limit
from vaoi_station.version import __version__

Frames = ReadFrame | ReducedFrames
"""The frames of a run. Reduced ones serve tiles that are reduced at least as much."""
NODATA = 0
"""Value of pixels of 8 or 16 bits that no frame shows; shown pixels are at least 1. Floats are NaN there."""
_LEAST_WEIGHT = np.float32(1e-6)
_LINEAR = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
_NEAREST = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP


def render_tile(spec: TileSpec, frames: Frames) -> NDArray[Any] | None:
    """Render a tile from its frames; None if no frame shows any of it.

    Returns pixels (h, w) or (h, w, 3) of the type of the frames; with HDR radiance (h, w), float32.

    Raises:
        InputError: frames differ in pixel type or number of channels.
    """
    return _with_bodies(_render_hdr(spec, frames), spec, frames) if spec.hdr else _render_plain(spec, frames)


def _render_plain(spec: TileSpec, frames: Frames) -> NDArray[Any] | None:
    """Render grey levels: Σ weight · (grey − dark) · factor / Σ weight over the frames of a tile."""
    formats: dict[tuple[np.dtype[Any], tuple[int, ...]], None] = {}
    full, channels = 255, 1
    sums, across, down = np.zeros(0, np.float32), np.zeros(0), np.zeros(0)
    for part in spec.parts:
        source = _source(part, frames, whole=True)
        if source is None:
            continue
        formats[source.pixels.dtype, source.pixels.shape[2:]] = None
        if not sums.size:
            full, channels = int(np.iinfo(source.pixels.dtype).max), math.prod(source.pixels.shape[2:])
            sums = np.zeros((2, spec.height, spec.width * channels), np.float32)
            m = spec.cells_from_tile
            across, down = (m[n, n] * np.arange(size) + m[n, 2] for n, size in enumerate((spec.width, spec.height)))
            across = np.repeat(across, channels)
        elif len(formats) > 1:
            raise _different_formats(list(formats))
        x0, y0, x1, y1 = part.window
        size = np.array([(x1 - x0, y1 - y0)])
        [pixels] = resampled(source.pixels, of_part(source.matrix, x0, y0)[None], size)
        if part.white_balance is not None:
            pixels = part.white_balance.applied(pixels)
        signal = pixels.astype(np.float32).reshape(y1 - y0, -1)
        fields = np.ones((2, *part.factor.shape), np.float32)
        fields[0] = part.factor
        if part.mine is not None:
            fields *= part.mine
        places = across[x0 * channels : x1 * channels] - part.cells[0], down[y0:y1] - part.cells[1]
        if part.wholly:
            _blend(signal, part.dark * full / 255, fields, *places, (x0 * channels, y0), sums)
        else:
            own = np.zeros((2, *signal.shape), np.float32)
            _blend(signal, part.dark * full / 255, fields, *places, (0, 0), own)
            area = np.s_[:, y0:y1, x0 * channels : x1 * channels]
            sums[area] += np.where(np.repeat(_outside(part, part.window), channels, axis=1), 0, own)
    if not formats:
        return None
    (dtype, colours), *_ = formats
    # Rounded and limited to the largest grey level; where there is no weight, 0 / 0 becomes 0.
    tile = np.asarray(cv2.divide(sums[0], sums[1], dtype=cv2.CV_8U if dtype == np.uint8 else cv2.CV_16U))
    # What is shown is at least 1.
    np.maximum(tile, 1, out=tile)
    if sums[1].min() <= _LEAST_WEIGHT:
        tile[sums[1] <= _LEAST_WEIGHT] = NODATA
    return tile.reshape(spec.height, spec.width, *colours) if tile.any() else None


@compiled
def _blend(
    signal: Floats32,
    dark: float,
    fields: Floats32,
    across: Floats,
    down: Floats,
    at: tuple[int, int],
    sums: Floats32,
) -> None:
    """Add a frame to the sums of a tile: of weight · (grey − dark) · factor, and of the weights.

    Args:
        signal: (h, w) grey levels, where the frame has a weight.
        dark: dark level.
        fields: (2, rows, columns) of the frame's cells: weight times factor, and weight.
        across: (w,) places of the columns of the signal between the centres of the cells.
        down: (h,) places of its lines.
        at: column and line of the first value in the sums.
        sums: (2, rows, columns) of the tile.
    """
    rows, columns = fields.shape[1], fields.shape[2]
    height, width = signal.shape
    black, last = np.float32(dark), -1
    # Of both fields, a line of cells at the columns of the signal, and how much the next line of cells differs.
    lines = np.empty((4, width), np.float32)
    factor, factor_step, weight, weight_step = lines[0], lines[1], lines[2], lines[3]
    for y in range(height):
        v = min(max(down[y], 0.0), rows - 1.0)
        top = min(int(v), max(rows - 2, 0))
        if top != last:
            last, below = top, min(top + 1, rows - 1)
            for x in range(width):
                u = min(max(across[x], 0.0), columns - 1.0)
                left = int(u)
                right, share = min(left + 1, columns - 1), np.float32(u - left)
                for field in range(2):
                    a, b = fields[field, top, left], fields[field, below, left]
                    a += share * (fields[field, top, right] - a)
                    b += share * (fields[field, below, right] - b)
                    lines[2 * field, x], lines[2 * field + 1, x] = a, b - a
        share, grey = np.float32(v - top), signal[y]
        total, weights = sums[0, at[1] + y, at[0] :], sums[1, at[1] + y, at[0] :]
        for x in range(width):
            total[x] += (factor[x] + share * factor_step[x]) * (grey[x] - black)
            weights[x] += weight[x] + share * weight_step[x]


def _different_formats(formats: Sequence[tuple[np.dtype[Any], tuple[int, ...]]]) -> InputError:
    names = ", ".join(f"{d.itemsize * 8} bits {'in colour' if channels else 'grey'}" for d, channels in formats)
    return InputError(
        f"The cameras of this mosaic have different pixel formats ({names}).",
        action="Give all cameras the same pixel_format.",
    )


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
        source = _source(part, frames)
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
    matrix: Floats
    """(3, 3) from pixels of the tile to these pixels."""
    largest: NDArray[Any]
    """The largest pixel of the frame in each of these pixels; `pixels` themselves if the frame is not reduced."""


def _source(part: FramePart, frames: Frames, whole: bool = False) -> _Source | None:
    """Return the part of the frame that the tile shows, reduced; None if the frame is missing or the part is empty.

    With `whole`, return the whole frame if it is not reduced.
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
        return _Source(shown.means, matrix, shown.largest)
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
    if not part.wholly:
        weight[_outside(part, box)] = 0
    return weight


def _outside(part: FramePart, box: Box) -> NDArray[np.bool_]:
    """Return which pixels of a box of the tile the frame does not show."""
    m = of_part(part.raw_from_tile, *box[:2])
    x, y = np.arange(box[2] - box[0]), np.arange(box[3] - box[1])[:, None]
    outside = np.zeros((y.size, x.size), np.bool_)
    for border, limit in enumerate(part.limits.tolist()):
        axis, sign = border % 2, 1.0 if border < 2 else -1.0
        # A pixel is inside if the nearest one of the frame is.
        a, b, c = sign * (m[axis] - (limit - 0.5 * sign) * m[2])
        outside |= a * x + b * y + c < 0
    return outside


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

    def tile(x: int, y: int) -> NDArray[Any]:
        x0, y0 = x * TILE_PX, y * TILE_PX
        box = x0, y0, min(x0 + TILE_PX, grid.width), min(y0 + TILE_PX, grid.height)
        part = render_tile(renderer.spec(box), cached)
        whole = np.full(layout.tile_shape, np.nan if plan.hdr else NODATA, dtype)
        if part is not None:
            # TIFF has the channels in the order red, green, blue; frames have them in that of OpenCV.
            whole[: part.shape[0], : part.shape[1]] = part if part.ndim == 2 else part[..., ::-1]
        return whole

    write_pyramid(path, layout, tile)
    return layout
