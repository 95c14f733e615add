"""Compiled sweep over heights: how unlike the frames are in each tile of a footprint, for every candidate height."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats

Ints = NDArray[np.int_]
_LEAST_VARIANCE = 0.01
"""Variance of a pixel that rounding alone makes after the blur, grey levels squared."""
_ROUNDS = 10
"""Steps of the power iteration that finds the largest eigenvalue of a small Gram matrix."""


class Sweep(NamedTuple):
    """What a sweep finds for t tiles, n heights and k pictures."""

    sums: Floats
    """(t, n) sum of squares that no common picture explains."""
    texture: Floats
    """(t, n) how much the pictures show that a common picture could explain.

    The sum over pictures of the logarithm of their variance, minus that of the common picture, times the number of
    values of a tile."""
    freedom: Ints
    """(t,) degrees of freedom of the sums."""
    used: NDArray[np.bool_]
    """(t, k) which pictures were used."""


class _Work(NamedTuple):
    """Arrays that the loops over heights and tiles use again and again."""

    line: NDArray[np.float32]
    """(2, w) the two lines of a picture between which a row lies, at its columns."""
    run: Ints
    """(2, w + 1) first columns, on a plane and in the picture, of runs in which both advance by one."""
    part: NDArray[np.float32]
    """(w,) distance of each column of a plane from the picture's column to its left."""
    slope: NDArray[np.float32]
    """(2, n) slopes along x and y of the pixels of a tile."""
    value: NDArray[np.float32]
    """(k, n) pixels of a tile."""
    gram: Floats
    """(k, k)."""
    member: Ints
    """(k,) pictures of a group."""
    vector: Floats
    """(2, k) an eigenvector, before and after a step."""


@compiled
def sweep(
    stack: NDArray[np.float32],
    margin: int,
    feet_px: Floats,
    shares: Floats,
    tiles: Ints,
    group: Ints,
    saturated: float,
) -> Sweep:
    """Compute for t tiles and n heights how much of the k pictures no common picture explains.

    The pictures of one group are compared with each other, up to a gain, an offset and a slope per tile and picture.
    The result is the sum of squares that remains if each picture is a multiple of one common picture, that is the trace
    of their Gram matrix minus its largest eigenvalue. Pictures without texture leave nothing at any height; so the
    texture is stated too.

    Args:
        stack: (k, h, w) pictures on the board's surface, with margin.
        margin: margin, px.
        feet_px: (k, 2) feet of the cameras in grid coordinates.
        shares: (n, k) heights over the surface as shares of the cameras' heights above it.
        tiles: (t, 4) first column, first row, width and height of the tiles in grid coordinates.
        group: (k,) number of the group of each picture.
        saturated: grey level from which on a pixel counts as saturated.
    """
    k, count, n = len(stack), len(tiles), len(shares)
    sums, texture = np.zeros((count, n)), np.zeros((count, n))
    freedom, used = np.zeros(count, np.int64), np.zeros((count, k), np.bool_)
    for t in range(count):
        for i in range(k):
            used[t, i] = _covers(stack[i], margin, feet_px[i], shares[:, i], tiles[t], saturated)
        freedom[t] = _freedom(used[t], group, tiles[t, 2] * tiles[t, 3])
    if not freedom.any():
        return Sweep(sums, texture, freedom, used)
    # Tiles touch or overlap, so each picture is laid on the plane of each height as a whole, in long lines.
    low, high = tiles[0, :2].copy(), tiles[0, :2].copy()
    most = 0
    for t in range(count):
        most = max(most, tiles[t, 2] * tiles[t, 3])
        for axis in range(2):
            low[axis] = min(low[axis], tiles[t, axis])
            high[axis] = max(high[axis], tiles[t, axis] + tiles[t, 2 + axis])
    planes = np.empty((k, high[1] - low[1], high[0] - low[0]), np.float32)
    work = _Work(
        np.empty((2, planes.shape[2]), np.float32),
        np.empty((2, planes.shape[2] + 1), np.int64),
        np.empty(planes.shape[2], np.float32),
        np.empty((2, most), np.float32),
        np.empty((k, most), np.float32),
        np.empty((k, k)),
        np.empty(k, np.int64),
        np.empty((2, k)),
    )
    for m in range(n):
        for i in range(k):
            _lay(stack[i], low, margin, feet_px[i], shares[m, i], planes[i], work)
        for t in range(count):
            if freedom[t] == 0:
                continue
            if t == 0 or tiles[t, 2] != tiles[t - 1, 2] or tiles[t, 3] != tiles[t - 1, 3] or freedom[t - 1] == 0:
                _slopes(tiles[t, 2], tiles[t, 3], work.slope)
            for i in range(k):
                if used[t, i]:
                    _read(planes[i], tiles[t, 0] - low[0], tiles[t, 1] - low[1], tiles[t], work.slope, work.value[i])
            sums[t, m], texture[t, m] = _unexplained(work, tiles[t, 2] * tiles[t, 3], used[t], group)
    return Sweep(sums, texture, freedom, used)


@inlined
def _freedom(used: NDArray[np.bool_], group: Ints, size: int) -> int:
    """Return the degrees of freedom of a tile. Pictures that are alone in their group are no longer used."""
    k, freedom = len(used), 0
    for i in range(k):
        same = 0
        for j in range(k):
            same += used[j] and group[j] == group[i]
        # every picture that is not alone in its group adds size − 3 values; each group takes one common picture
        if used[i] and same < 2:
            used[i] = False
        elif used[i]:
            first = True
            for j in range(i):
                first = first and not (used[j] and group[j] == group[i])
            freedom += 0 if first else size - 3
    return freedom


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
def _lay(
    picture: NDArray[np.float32],
    first: Ints,
    margin: int,
    foot: Floats,
    share: float,
    plane: NDArray[np.float32],
    work: _Work,
) -> None:
    """Write a picture as it is at one height to `plane`, from the column and row `first` on. It is bilinear.

    Values beside the picture are any: they belong to tiles that are not used (`_covers`).
    """
    step = 1 / (1 - share)
    bx, by = (first[0] - share * foot[0]) * step + margin, (first[1] - share * foot[1]) * step + margin
    rows, width, run, part = picture.shape[0], plane.shape[1], work.run, work.part
    runs, before = 0, -2
    for c in range(width):
        u = bx + c * step
        left = min(max(int(u), 0), picture.shape[1] - 2)
        part[c] = u - left
        if left != before + 1 or c == 0:
            run[0, runs], run[1, runs] = c, left
            runs += 1
        before = left
    run[0, runs] = width
    # The lower line of one row is most often the upper line of the next.
    last, lower = -2, 0
    for r in range(plane.shape[0]):
        v = by + r * step
        top = min(max(int(v), 0), rows - 2)
        if top != last:
            for line in range(top + (top == last + 1), top + 2):
                lower = 1 - lower
                for n in range(runs):
                    # Within a run neighbours in the picture are neighbours in memory, as vector registers need them.
                    c, length = run[0, n], run[0, n + 1] - run[0, n]
                    near, out = picture[line, run[1, n] :], work.line[lower, c : c + length]
                    away = part[c : c + length]
                    for m in range(length):
                        at = np.uint64(m)
                        out[at] = near[at] + away[at] * (near[at + np.uint64(1)] - near[at])
            last = top
        down, above, below, out = np.float32(v - top), work.line[1 - lower], work.line[lower], plane[r]
        for c in range(width):
            out[c] = above[c] + down * (below[c] - above[c])


@inlined
def _slopes(w: int, h: int, slope: NDArray[np.float32]) -> None:
    """Write the slopes along x and along y of w × h values, line by line, to the rows of `slope`."""
    for n in range(w * h):
        slope[0, n], slope[1, n] = n % w - (w - 1) / 2, n // w - (h - 1) / 2


@inlined
def _read(
    plane: NDArray[np.float32],
    column: int,
    row: int,
    tile: Ints,
    slope: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Write the pixels of a tile, minus their mean and slope, to `out`."""
    w, h = tile[2], tile[3]
    size = w * h
    for r in range(h):
        at, source = np.uint64(r * w), plane[row + r]
        for c in range(w):
            out[at + np.uint64(c)] = source[np.uint64(column + c)]
    # Vignetting and uneven lamps add a slope, which differs between frames and would look like a displacement.
    total = slope_x = slope_y = np.float32(0)
    for n in range(size):
        total += out[n]
        slope_x += out[n] * slope[0, n]
        slope_y += out[n] * slope[1, n]
    mean = total / np.float32(size)
    slope_x /= np.float32(h * w * (w * w - 1) / 12 + 1e-9)
    slope_y /= np.float32(w * h * (h * h - 1) / 12 + 1e-9)
    for n in range(size):
        out[n] -= mean + slope_x * slope[0, n] + slope_y * slope[1, n]


@inlined
def _unexplained(work: _Work, size: int, used: NDArray[np.bool_], group: Ints) -> tuple[float, float]:
    """Return the sum over groups of the trace of the Gram matrix minus its largest eigenvalue, and the texture."""
    k, total, texture = len(used), 0.0, 0.0
    values, gram, member = work.value, work.gram, work.member
    least = _LEAST_VARIANCE * (size - 3)
    for first in range(k):
        m = 0
        for i in range(k):
            if used[i] and group[i] == group[first]:
                member[m] = i
                m += 1
        if not m or member[0] != first:
            continue
        trace = 0.0
        for i in range(m):
            for j in range(i + 1):
                dot = np.float32(0)
                a, b = values[member[i]], values[member[j]]
                for p in range(size):
                    dot += a[p] * b[p]
                gram[i, j] = gram[j, i] = dot
            trace += gram[i, i]
        largest = _largest(gram, m, trace, work.vector)
        total += trace - largest
        # One logarithm for all pictures: shares of the trace, since their product stays within the range of floats.
        shares, whole = 1.0, trace + m * least
        for i in range(m):
            shares *= (gram[i, i] + least) / whole * m
        texture += math.log(shares * whole / m / (largest + least)) + (m - 1) * math.log(whole / m / (size - 3))
    return total, texture * (size - 3)


@inlined
def _largest(gram: Floats, m: int, trace: float, vectors: Floats) -> float:
    """Return the largest eigenvalue of the first m rows and columns of a Gram matrix."""
    if m < 2:
        return trace
    if m == 2:
        return float((trace + np.sqrt((gram[0, 0] - gram[1, 1]) ** 2 + 4 * gram[0, 1] ** 2)) / 2)
    # Divided by the trace, the largest eigenvalue lies between 1 / m and 1: the vector needs no norm in between.
    vector, turned, scale, square, product = vectors[0], vectors[1], 1 / (trace + 1e-30), 0.0, 0.0
    for i in range(m):
        vector[i] = (gram[i, 0] + gram[i, m - 1]) * scale
    for step in range(_ROUNDS):
        for i in range(m):
            total = 0.0
            for j in range(m):
                total += gram[i, j] * vector[j]
            turned[i] = total * scale
            if step == _ROUNDS - 1:
                square, product = square + vector[i] ** 2, product + turned[i] * vector[i]
        for i in range(m):
            vector[i] = turned[i]
    return product / (square + 1e-300) * trace
