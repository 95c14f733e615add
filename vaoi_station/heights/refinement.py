"""Compiled normal equations of a height: how the pictures of a body differ after they were laid over one another.

All pictures of one group show one common picture T, each with its own gain, displaced by a·δ + d: a is the parallax
per mm, δ the error of the height, d the error of the frame's matrix at this place. Linearised, the difference of a
picture from T is −g·∇T·(a·δ + d), minus the mean of the group.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats

Ints = NDArray[np.int_]
_ROUNDS = 10


class Normals(NamedTuple):
    """Normal equations of t tiles for the unknowns (δ, d of each of the k pictures); m = 1 + 2·k."""

    matrix: Floats
    """(t, m, m) free of the noise of gradients: products of two different pictures."""
    noisy: Floats
    """(t,) entry (0, 0) of the same matrix with that noise."""
    vector: Floats
    """(t, m)."""
    variance: Floats
    """(t,) variance of one pixel."""


class _Work(NamedTuple):
    """Arrays that the loop over tiles uses again and again; c of the k pictures belong to one group."""

    value: Floats
    """(k, n) pixels of a tile, and their gradients."""
    gx: Floats
    gy: Floats
    gram: Floats
    gain: Floats
    """(k,)."""
    ax: Floats
    """(k, m) displacement of each picture along x per unit of each unknown, and along y."""
    ay: Floats
    slope: Floats
    """(k, 2) products of a picture's difference with the gradients."""
    common: Floats
    """(3, n) the common picture and its gradients, times the sum of the squares of the gains."""
    ramp: Floats
    """(2, n) slopes along x and y of the pixels of a tile."""


@compiled
def normal_equations(
    stack: NDArray[np.float32], lean: Floats, tiles: Ints, used: NDArray[np.bool_], group: Ints
) -> Normals:
    """Compute the normal equations of every tile, for a variance of 1 per pixel.

    Args:
        stack: (k, h, w) pictures on the plane at the present height.
        lean: (t, k, 2) displacement of each picture at each tile, px per mm.
        tiles: (t, 4) first column, first row, width and height.
        used: (t, k) which pictures show which tile.
        group: (k,) number of the group of each picture.
    """
    k, t = len(stack), len(tiles)
    m, most = 1 + 2 * k, 0
    for n in range(t):
        most = max(most, tiles[n, 2] * tiles[n, 3])
    work = _Work(
        np.empty((k, most)),
        np.empty((k, most)),
        np.empty((k, most)),
        np.empty((k, k)),
        np.empty(k),
        np.empty((k, m)),
        np.empty((k, m)),
        np.empty((k, 2)),
        np.empty((3, most)),
        np.empty((2, most)),
    )
    member = np.empty(k, np.int64)
    matrix, noisy, vector, variance = np.zeros((t, m, m)), np.zeros(t), np.zeros((t, m)), np.zeros(t)
    for n in range(t):
        size = tiles[n, 2] * tiles[n, 3]
        squares, freedom = 0.0, 0
        if n == 0 or tiles[n, 2] != tiles[n - 1, 2] or tiles[n, 3] != tiles[n - 1, 3]:
            for p in range(size):
                work.ramp[0, p] = p % tiles[n, 2] - (tiles[n, 2] - 1) / 2
                work.ramp[1, p] = p // tiles[n, 2] - (tiles[n, 3] - 1) / 2
        for first in range(k):
            c = 0
            for i in range(_members(used[n], group, first, member)):
                if _read(stack[member[i]], tiles[n], work.ramp, work.value[c], work.gx[c], work.gy[c]):
                    member[c] = member[i]
                    c += 1
            if c < 2:
                continue
            _gains(work.value, size, c, work.gram, work.gain)
            all2, all4 = 0.0, 0.0
            for i in range(c):
                all2 += work.gain[i] ** 2
                all4 += work.gain[i] ** 4
            cross = all2 * all2 - all4
            # One picture that is far brighter than the others leaves no product of two different ones.
            if cross < 1e-3 * all2 * all2:
                continue
            _displacements(lean[n], member, c, all2, work)
            squares += _add_group(size, c, all2, cross, work, matrix[n], vector[n], noisy[n : n + 1])
            freedom += (size - 3) * (c - 1)
        variance[n] = squares / max(freedom, 1)
    return Normals(matrix, noisy, vector, variance)


@inlined
def _members(used: NDArray[np.bool_], group: Ints, first: int, member: Ints) -> int:
    """Write the used pictures of the group of picture `first` to `member`; return 0 if it is not the group's first."""
    c = 0
    for i in range(len(used)):
        if used[i] and group[i] == group[first]:
            member[c] = i
            c += 1
    return c if c and member[0] == first else 0


@inlined
def _displacements(lean: Floats, member: Ints, c: int, all2: float, work: _Work) -> None:
    """Compute how each unknown displaces each picture, minus the weighted mean of the group."""
    ax, ay, gain = work.ax, work.ay, work.gain
    for i in range(c):
        for u in range(ax.shape[1]):
            ax[i, u] = ay[i, u] = 0.0
        ax[i, 0], ay[i, 0] = lean[member[i], 0], lean[member[i], 1]
        ax[i, 1 + 2 * member[i]], ay[i, 2 + 2 * member[i]] = 1.0, 1.0
    for u in range(ax.shape[1]):
        mean_x = mean_y = 0.0
        for i in range(c):
            mean_x += gain[i] ** 2 * ax[i, u] / all2
            mean_y += gain[i] ** 2 * ay[i, u] / all2
        for i in range(c):
            ax[i, u] -= mean_x
            ay[i, u] -= mean_y


@inlined
def _add_group(
    size: int, c: int, all2: float, cross: float, work: _Work, matrix: Floats, vector: Floats, noisy: Floats
) -> float:
    """Add the equations of one group in one tile; return the sum of squares of the differences."""
    value, gain, slope, ax, ay = work.value, work.gain, work.slope, work.ax, work.ay
    xx = xy = yy = sxx = sxy = syy = squares = 0.0
    total, tx, ty = work.common[0], work.common[1], work.common[2]
    for p in range(size):
        total[p] = tx[p] = ty[p] = 0.0
    for i in range(c):
        own, gx, gy, g = value[i], work.gx[i], work.gy[i], gain[i]
        for p in range(size):
            a, b = g * gx[p], g * gy[p]
            total[p] += g * own[p]
            tx[p] += a
            ty[p] += b
            sxx, sxy, syy = sxx + a * a, sxy + a * b, syy + b * b
    for p in range(size):
        xx, xy, yy = xx + tx[p] * tx[p], xy + tx[p] * ty[p], yy + ty[p] * ty[p]
    for i in range(c):
        own, share, along, across = value[i], gain[i] / all2, 0.0, 0.0
        for p in range(size):
            e = own[p] - share * total[p]
            squares += e * e
            along += e * tx[p]
            across += e * ty[p]
        slope[i, 0], slope[i, 1] = -share * along, -share * across
    wxx, wxy, wyy = xx / all2**2, xy / all2**2, yy / all2**2
    # Products of the gradients of two different pictures: their noise is independent.
    pxx, pxy, pyy = (xx - sxx) / cross, (xy - sxy) / cross, (yy - syy) / cross
    for i in range(c):
        w = gain[i] ** 2
        for u in range(ax.shape[1]):
            vector[u] += ax[i, u] * slope[i, 0] + ay[i, u] * slope[i, 1]
            for v in range(ax.shape[1]):
                mixed = ax[i, u] * ay[i, v] + ay[i, u] * ax[i, v]
                matrix[u, v] += w * (pxx * ax[i, u] * ax[i, v] + pxy * mixed + pyy * ay[i, u] * ay[i, v])
        noisy[0] += w * (wxx * ax[i, 0] ** 2 + 2 * wxy * ax[i, 0] * ay[i, 0] + wyy * ay[i, 0] ** 2)
    return squares


@inlined
def _read(picture: NDArray[np.float32], tile: Ints, ramp: Floats, value: Floats, gx: Floats, gy: Floats) -> bool:
    """Read a tile minus its mean and slope, and its gradients; return False where the picture has no value."""
    w, total = tile[2], 0.0
    for r in range(tile[3]):
        above, row, below = picture[tile[1] + r - 1], picture[tile[1] + r], picture[tile[1] + r + 1]
        for c in range(w):
            n, x = r * w + c, tile[0] + c
            value[n] = row[x]
            gx[n] = (row[x + 1] - row[x - 1]) / 2
            gy[n] = (below[x] - above[x]) / 2
            total += value[n] + 0 * (gx[n] + gy[n])
    if np.isnan(total):
        return False
    # The same is removed from the gradients: a displacement shows only in what remains of the values.
    for part in (value, gx, gy):
        _detrend(part, w, tile[3], ramp)
    return True


@inlined
def _detrend(values: Floats, w: int, h: int, ramp: Floats) -> None:
    """Subtract mean and slope from the w × h values of a tile."""
    mean = slope_x = slope_y = 0.0
    along, across = ramp[0], ramp[1]
    for i in range(w * h):
        mean += values[i]
        slope_x += values[i] * along[i]
        slope_y += values[i] * across[i]
    mean /= w * h
    slope_x /= h * w * (w * w - 1) / 12 + 1e-9
    slope_y /= w * h * (h * h - 1) / 12 + 1e-9
    for i in range(w * h):
        values[i] -= mean + slope_x * along[i] + slope_y * across[i]


@inlined
def _gains(value: Floats, size: int, c: int, gram: Floats, gain: Floats) -> None:
    """Write the gains of c pictures, the first eigenvector of their Gram matrix, with a mean square of 1."""
    for i in range(c):
        for j in range(i + 1):
            dot = 0.0
            for p in range(size):
                dot += value[i, p] * value[j, p]
            gram[i, j] = gram[j, i] = dot
    for i in range(c):
        gain[i] = 1.0
    for _ in range(_ROUNDS):
        norm = 0.0
        turned = np.zeros(c)
        for i in range(c):
            for j in range(c):
                turned[i] += gram[i, j] * gain[j]
            norm += turned[i] ** 2
        norm = np.sqrt(norm / c) + 1e-30
        for i in range(c):
            gain[i] = turned[i] / norm
