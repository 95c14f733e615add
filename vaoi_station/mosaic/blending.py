"""The inner loop of mosaics: corrects the grey levels of resampled frames, and blends them where they meet."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats

Floats32 = NDArray[np.float32]
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
