"""Compiled sweep over heights: how unlike the frames are in each tile of a footprint, for every candidate height."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats

Ints = NDArray[np.int_]
_ROUNDS = 10
"""Steps of the power iteration that finds the largest eigenvalue of a small Gram matrix."""


@compiled
def sweep(
    stack: NDArray[np.float32],
    margin: int,
    feet_px: Floats,
    shares: Floats,
    tiles: Ints,
    group: Ints,
    saturated: float,
) -> tuple[Floats, Ints, NDArray[np.bool_]]:
    """Compute for t tiles and n heights how much of the k pictures no common picture explains.

    The pictures of one group are compared with each other, up to a gain, an offset and a slope per tile and picture.
    The result is the sum of squares that remains if each picture is a multiple of one common picture, that is the trace
    of their Gram matrix minus its largest eigenvalue.

    Args:
        stack: (k, h, w) pictures on the board's surface, with margin.
        margin: margin, px.
        feet_px: (k, 2) feet of the cameras in grid coordinates.
        shares: (n, k) heights over the surface as shares of the cameras' heights above it.
        tiles: (t, 4) first column, first row, width and height of the tiles in grid coordinates.
        group: (k,) number of the group of each picture.
        saturated: grey level from which on a pixel counts as saturated.

    Returns:
        Sums of squares (t, n), degrees of freedom (t,), and which pictures were used (t, k).
    """
    k, count, n = len(stack), len(tiles), len(shares)
    sums, freedom, used = np.zeros((count, n)), np.zeros(count, np.int64), np.zeros((count, k), np.bool_)
    most = 0
    for t in range(count):
        most = max(most, tiles[t, 2] * tiles[t, 3])
    values, gram = np.empty((k, most), np.float32), np.empty((k, k))
    for t in range(count):
        size = tiles[t, 2] * tiles[t, 3]
        for i in range(k):
            used[t, i] = _covers(stack[i], margin, feet_px[i], shares[:, i], tiles[t], saturated)
        for i in range(k):
            same = 0
            for j in range(k):
                same += used[t, j] and group[j] == group[i]
            # every picture that is not alone in its group adds size − 3 values; each group takes one common picture
            if used[t, i] and same < 2:
                used[t, i] = False
            elif used[t, i]:
                first = True
                for j in range(i):
                    first = first and not (used[t, j] and group[j] == group[i])
                freedom[t] += 0 if first else size - 3
        if freedom[t] == 0:
            continue
        for m in range(n):
            for i in range(k):
                if used[t, i]:
                    _read(stack[i], margin, feet_px[i], shares[m, i], tiles[t], values[i])
            sums[t, m] = _unexplained(values, size, used[t], group, gram)
    return sums, freedom, used


@inlined
def _covers(
    picture: NDArray[np.float32], margin: int, foot: Floats, shares: Floats, tile: Ints, saturated: float
) -> bool:
    """Return whether a picture shows a tile at all heights without many saturated pixels."""
    low_x = low_y = 1e9
    high_x = high_y = -1e9
    for share in (shares[0], shares[-1]):
        for corner in range(4):
            px = tile[0] + (tile[2] - 1 if corner % 2 else 0)
            py = tile[1] + (tile[3] - 1 if corner // 2 else 0)
            x, y = (px - share * foot[0]) / (1 - share) + margin, (py - share * foot[1]) / (1 - share) + margin
            low_x, high_x, low_y, high_y = min(low_x, x), max(high_x, x), min(low_y, y), max(high_y, y)
    a, b, c, d = int(np.floor(low_x)), int(np.floor(high_x)) + 1, int(np.floor(low_y)), int(np.floor(high_y)) + 1
    if a < 0 or c < 0 or b >= picture.shape[1] or d >= picture.shape[0]:
        return False
    bright = total = 0
    for y in range(c, d + 1):
        for x in range(a, b + 1):
            if np.isnan(picture[y, x]):
                return False
            total += 1
            bright += picture[y, x] >= saturated
    return bright * 20 <= total


@inlined
def _read(
    picture: NDArray[np.float32],
    margin: int,
    foot: Floats,
    share: float,
    tile: Ints,
    out: NDArray[np.float32],
) -> None:
    """Write the pixels of a tile at one height, minus their mean and slope, to `out`. Interpolation is bilinear."""
    x0, y0, w, h = tile[0], tile[1], tile[2], tile[3]
    step = 1 / (1 - share)
    bx, by = (x0 - share * foot[0]) * step + margin, (y0 - share * foot[1]) * step + margin
    half_x, half_y = np.float32((w - 1) / 2), np.float32((h - 1) / 2)
    # Vignetting and uneven lamps add a slope, which differs between frames and would look like a displacement.
    total = slope_x = slope_y = np.float32(0)
    n = np.uint64(0)
    for r in range(h):
        v = by + r * step
        top = int(v)
        ty = np.float32(v - top)
        upper, lower = picture[top], picture[top + 1]
        row = along = np.float32(0)
        for c in range(w):
            u = bx + c * step
            # Unsigned: indexes that cannot be negative (`_covers`) are read without a test.
            left, right = np.uint64(int(u)), np.uint64(int(u) + 1)
            tx = np.float32(u - int(u))
            a = upper[left] + tx * (upper[right] - upper[left])
            b = lower[left] + tx * (lower[right] - lower[left])
            value = a + ty * (b - a)
            out[n + np.uint64(c)] = value
            row += value
            along += value * (np.float32(c) - half_x)
        total += row
        slope_x += along
        slope_y += row * (np.float32(r) - half_y)
        n += np.uint64(w)
    mean = total / np.float32(w * h)
    slope_x /= np.float32(h * w * (w * w - 1) / 12 + 1e-9)
    slope_y /= np.float32(w * h * (h * h - 1) / 12 + 1e-9)
    n = np.uint64(0)
    for r in range(h):
        base = mean + (np.float32(r) - half_y) * slope_y - half_x * slope_x
        for c in range(w):
            out[n + np.uint64(c)] -= base + np.float32(c) * slope_x
        n += np.uint64(w)


@inlined
def _unexplained(values: NDArray[np.float32], size: int, used: NDArray[np.bool_], group: Ints, gram: Floats) -> float:
    """Return the sum over groups of the trace of the Gram matrix minus its largest eigenvalue."""
    k, total = len(used), 0.0
    done = np.zeros(k, np.bool_)
    member = np.empty(k, np.int64)
    vector, turned = np.empty(k), np.empty(k)
    for first in range(k):
        if done[first] or not used[first]:
            continue
        m = 0
        for i in range(first, k):
            if used[i] and group[i] == group[first]:
                member[m] = i
                done[i] = True
                m += 1
        trace = 0.0
        for i in range(m):
            for j in range(i + 1):
                dot = np.float32(0)
                a, b = values[member[i]], values[member[j]]
                for p in range(size):
                    dot += a[p] * b[p]
                gram[i, j] = gram[j, i] = dot
            trace += gram[i, i]
        total += trace - _largest(gram, m, trace, vector, turned)
    return total


@inlined
def _largest(gram: Floats, m: int, trace: float, vector: Floats, turned: Floats) -> float:
    """Return the largest eigenvalue of the first m rows and columns of a Gram matrix."""
    if m < 2:
        return trace
    if m == 2:
        return float((trace + np.sqrt((gram[0, 0] - gram[1, 1]) ** 2 + 4 * gram[0, 1] ** 2)) / 2)
    for i in range(m):
        vector[i] = gram[i, 0] + gram[i, m - 1]
    largest = 0.0
    for _ in range(_ROUNDS):
        norm = 0.0
        for i in range(m):
            norm += vector[i] ** 2
        norm = np.sqrt(norm) + 1e-30
        for i in range(m):
            vector[i] /= norm
        largest = 0.0
        for i in range(m):
            turned[i] = 0.0
            for j in range(m):
                turned[i] += gram[i, j] * vector[j]
            largest += turned[i] * vector[i]
        for i in range(m):
            vector[i] = turned[i]
    return largest
