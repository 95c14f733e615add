"""Inner loops of mosaics: correct the grey levels of a resampled frame, and add them to a tile with their weights."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats

Floats32 = NDArray[np.float32]


class Nodes(NamedTuple):
    """Where the pixels of a tile lie between the centres of cells, along one axis."""

    cell: NDArray[np.int32]
    """(n,) the cell before each pixel; the next one exists."""
    share: Floats32
    """(n,) weight of the next cell."""


class Corrections(NamedTuple):
    """What is done to a resampled frame; values (h, w) belong to the centres of cells."""

    factor: Floats32
    mine: Floats32
    """Weight of the frame."""
    raw_from_tile: Floats
    """(3, 3) matrix from pixels of the tile to raw pixels of the frame."""
    limits: Floats
    """(4,) least x and y, largest x and y of raw pixels that count as inside."""
    dark: float


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


@compiled
def add_frame(
    total: Floats32,
    weights: Floats32,
    pixels: NDArray[Any],
    x: Nodes,
    y: Nodes,
    corrections: Corrections,
    corner: tuple[int, int],
) -> None:
    """Add a part of a frame to a tile: weight · (grey − dark) · factor, and the weight.

    `total` and `weights` are those of the tile; all others begin at the part's `corner`, the first column and row.
    """
    # All arrays are contiguous, and the inner loop runs over a whole line: only then does the compiler use vector
    # registers.
    height, width = pixels.shape
    factor, mine, m, limits, dark = corrections
    rows, columns = factor.shape
    factors, shares = np.empty((rows, width), np.float32), np.empty((rows, width), np.float32)
    for r in range(rows):
        for s in range(width):
            i, t = x.cell[s], x.share[s]
            n = min(i + 1, columns - 1)
            factors[r, s] = factor[r, i] + t * (factor[r, n] - factor[r, i])
            shares[r, s] = mine[r, i] + t * (mine[r, n] - mine[r, i])
    black = np.float32(dark)
    for v in range(height):
        j, q = y.cell[v], y.share[v]
        k = min(j + 1, rows - 1)
        first, end = _inside(m, limits, v, width)
        if end <= first:
            continue
        above, below = factors[j, first:end], factors[k, first:end]
        weight_above, weight_below, greys = shares[j, first:end], shares[k, first:end], pixels[v, first:end]
        left, right = corner[0] + first, corner[0] + end
        sums, counts = total[corner[1] + v, left:right], weights[corner[1] + v, left:right]
        for s in range(end - first):
            weight = weight_above[s] + q * (weight_below[s] - weight_above[s])
            gain = above[s] + q * (below[s] - above[s])
            sums[s] += weight * gain * (np.float32(greys[s]) - black)
            counts[s] += weight


@compiled
def finish(total: Floats32, weights: Floats32, full: float, out: NDArray[Any]) -> None:
    """Divide by the weights and round to whole grey levels from 1 to `full`; 0 where there is no weight."""
    height, width = total.shape
    most = np.float32(full)
    for v in range(height):
        for u in range(width):
            w = weights[v, u]
            value = total[v, u] / w + np.float32(0.5) if w > np.float32(1e-6) else np.float32(0)
            value = min(max(value, np.float32(1)), most)
            out[v, u] = int(value) if w > np.float32(1e-6) else 0
