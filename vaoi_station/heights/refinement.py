"""Compiled normal equations of a height: how the pictures of a body differ after they were laid over one another.

All pictures of one group show one common picture T, each with its own gain, displaced by a·δ + d: a is the parallax
per mm, δ the error of the height, d the error of the frame's matrix at this place. Linearised, the difference of a
picture from T is −g·∇T·(a·δ + d), minus the mean of the group. The size of the d is estimated from all bodies of the
run together (restricted maximum likelihood), and for each body again with that as the prior.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.small_sorts import ascending
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


NOISE_AREA = 12.0
"""Number of pixels that share one independent value of noise after the blur."""
UNLIKE = 0.003
"""Share of a texture's variance that a displacement of about 0.1 px leaves: the sweep's steps, errors of matrices."""
_MISFIT_AREA = 30.0
"""The same for differences beyond noise, such as glare: they have the size of the texture."""
_COMMON = 0.25
"""Share of the differences beyond noise that is the same in all tiles of a body."""
_DISPLACED_PX = 0.05
"""Standard deviation of the displacement of a picture before it is known."""


class TileEquations(NamedTuple):
    """The normal equations of t tiles, divided by their variances."""

    matrix: Floats
    """(t, m, m)."""
    vector: Floats
    """(t, m)."""
    noisy: Floats
    """(t,) as `Normals.noisy`."""
    unlike_mm: float
    """Standard deviation of the height by differences that all tiles have in common, such as glare."""


class Sum(NamedTuple):
    """The sum of the equations of all tiles, divided by what they scatter more than their noise explains."""

    step_mm: float
    """The height that solves them."""
    matrix: Floats
    """(m, m)."""
    vector: Floats
    """(m,)."""


@compiled
def weigh_tiles(found: Normals, tiles: Ints, lowest: float, edge_mm: float) -> TileEquations:
    """Divide the equations of every tile by its variance, which accounts for noise, misfit and edges.

    Args:
        found: the equations for a variance of 1 per pixel.
        tiles: (t, 4) tiles on the body.
        lowest: least variance of a pixel.
        edge_mm: standard deviation of the error that tiles at edges have in common; see `edge_weights`.
    """
    t = len(tiles)
    some, count = np.empty(t), 0
    for i in range(t):
        if found.variance[i] > 0:
            some[count] = found.variance[i]
            count += 1
    order = ascending(some[:count])
    # The value above which nine tenths lie.
    at = 0.1 * (count - 1)
    low, high = some[order[int(at)]], some[order[math.ceil(at)]]
    floor = max(low + (at - int(at)) * (high - low), lowest)
    variance, information = np.empty(t), np.empty(t)
    for i in range(t):
        misfit = max(found.variance[i] - 3 * floor, 0.0)
        variance[i] = max(found.variance[i], floor) * NOISE_AREA + misfit * _MISFIT_AREA
        information[i] = max(found.matrix[i, 0, 0], 0.0) / variance[i]
    factor = edge_weights(tiles, information, edge_mm)
    matrix, vector, noisy = np.empty_like(found.matrix), np.empty_like(found.vector), np.empty(t)
    unlike = total = 0.0
    for i in range(t):
        share = factor[i] / variance[i]
        for u in range(matrix.shape[1]):
            vector[i, u] = found.vector[i, u] * share
            for v in range(matrix.shape[1]):
                matrix[i, u, v] = found.matrix[i, u, v] * share
        noisy[i] = found.noisy[i] * share
        excess = max(found.variance[i] - 3 * floor, 0.0) * (tiles[i, 2] * tiles[i, 3])
        unlike += factor[i] * information[i] * math.sqrt(excess / max(found.matrix[i, 0, 0], 1e-3))
        total += factor[i] * information[i]
    return TileEquations(matrix, vector, noisy, _COMMON * unlike / max(total, 1e-9))


@inlined
def edge_weights(tiles: Ints, information: Floats, sigma_mm: float) -> Floats:
    """Return factors (t,) of the information of tiles, which account for the error that tiles at edges have in common.

    A body with texture has it everywhere; the outermost tiles are then hardly worse than others. A blank body shows
    little but its edges. So the error counts as far as the outermost tiles contain more information than the inner
    ones. With a variance s² in common, information I is worth 1 / (1 / I + s²).

    Args:
        tiles: (t, 4) tiles on the body.
        information: (t,) inverse variance of the height of each tile, 1/mm².
        sigma_mm: standard deviation of the error at edges.
    """
    left, top, right, bottom = tiles[0, 0], tiles[0, 1], tiles[0, 0], tiles[0, 1]
    for i in range(len(tiles)):
        left, top = min(left, tiles[i, 0]), min(top, tiles[i, 1])
        right, bottom = max(right, tiles[i, 0]), max(bottom, tiles[i, 1])
    outer, factor = np.empty(len(tiles), np.bool_), np.ones(len(tiles))
    at_edges, inner, count = 0.0, 0.0, 0
    for i in range(len(tiles)):
        outer[i] = not (left < tiles[i, 0] < right and top < tiles[i, 1] < bottom)
        if outer[i]:
            at_edges += information[i]
            count += 1
        else:
            inner += information[i]
    texture = inner / max(len(tiles) - count, 1) * count
    share = min(max(1 - texture / max(at_edges, 1e-12), 0.0), 1.0)
    for i in range(len(tiles)):
        if outer[i]:
            factor[i] = 1 / (1 + at_edges * (share * sigma_mm) ** 2)
    return factor


@compiled
def add_up(tiles: TileEquations, weight: Floats) -> Sum:
    """Add up the equations of tiles with these weights (t,), some of which are not 0."""
    t, m = tiles.vector.shape
    n, b = np.zeros((m, m)), np.zeros(m)
    total = squares = noise = 0.0
    for i in range(t):
        total, squares, noise = total + weight[i], squares + weight[i] ** 2, noise + weight[i] * tiles.noisy[i]
        for u in range(m):
            b[u] += weight[i] * tiles.vector[i, u]
            for v in range(m):
                n[u, v] += weight[i] * tiles.matrix[i, u, v]
    full, theta = n.copy(), b.copy()
    for u in range(m):
        full[u, u] += 1 / _DISPLACED_PX**2 if u else 1e-9
    _solve(full, theta)
    scatter = own = 0.0
    for i in range(t):
        off = tiles.vector[i, 0]
        for u in range(m):
            off -= tiles.matrix[i, 0, u] * theta[u]
        scatter += weight[i] * off**2 / (tiles.noisy[i] + 1e-12)
        own += (weight[i] * off) ** 2
    inflation = noise / n[0, 0] * max(1.0, scatter / max(total - 1, 1.0))
    # The sum of the tiles' own deviations is the variance of the sum, however unlike the tiles are (sandwich).
    count = total**2 / squares
    inflation = max(inflation, own / n[0, 0] * count / max(count - 1, 1.0))
    return Sum(theta[0], n / inflation, b / inflation)


@inlined
def _solve(a: Floats, x: Floats) -> None:
    """Replace the right side x by the solution of a · x; `a` is overwritten (elimination with pivots in columns)."""
    m = len(x)
    for u in range(m):
        best = u
        for v in range(u + 1, m):
            best = v if abs(a[v, u]) > abs(a[best, u]) else best
        for v in range(u, m):
            a[u, v], a[best, v] = a[best, v], a[u, v]
        x[u], x[best] = x[best], x[u]
        for v in range(u + 1, m):
            factor = a[v, u] / a[u, u]
            for w in range(u, m):
                a[v, w] -= factor * a[u, w]
            x[v] -= factor * x[u]
    for u in range(m - 1, -1, -1):
        for v in range(u + 1, m):
            x[u] -= a[u, v] * x[v]
        x[u] /= a[u, u]


@compiled
def tile_weights(matrix: Floats, vector: Floats, noisy: Floats) -> Floats:
    """Compute the weights (t,) of t tiles, from 0 to 1, around the height that most of them have (Tukey's biweight).

    All are 0 if the tiles have no texture.

    Args:
        matrix: (t, p, p) normal matrices of the tiles, divided by their variances; the first parameter is the height.
        vector: (t, p) right sides of their normal equations.
        noisy: (t,) information on the height that noise alone would add.
    """
    t = len(noisy)
    mm, sigma, weight = np.empty(t), np.empty(t), np.empty(t)
    for i in range(t):
        own = max(matrix[i, 0, 0], 1e-3 * noisy[i] + 1e-12)
        mm[i] = vector[i, 0] / own
        sigma[i] = math.sqrt(noisy[i] / own**2 + _UNEVEN_MM**2)
    # A few tiles may show a lead, a fillet of solder or a neighbour, most often lower than the body.
    centre = _weighted_median(mm, sigma)
    for _ in range(_WEIGHT_ROUNDS):
        texture = noise = pull = 0.0
        for i in range(t):
            weight[i] = max(1 - ((mm[i] - centre) / (_TIGHT * sigma[i])) ** 2, 0.0) ** 2
            texture += weight[i] * matrix[i, 0, 0]
            noise += weight[i] * noisy[i]
            pull += weight[i] * vector[i, 0]
        if texture <= _INFORMED * noise or texture <= 0:
            for i in range(t):
                weight[i] = 0.0
            break
        centre = pull / texture
    return weight


@inlined
def _weighted_median(values: Floats, sigma: Floats) -> float:
    """Return the value below and above which lies half of the weight 1/σ²."""
    order, total, below = ascending(values), 0.0, 0.0
    for i in range(len(values)):
        total += 1 / sigma[i] ** 2
    half = 0.5 * total
    for i in order:
        below += 1 / sigma[i] ** 2
        if below >= half:
            return float(values[i])
    return float(values[order[-1]])


_INFORMED = 0.1
"""Least share of the squared gradients that is texture; with less, it is noise."""
_TIGHT = 4.0
"""Tiles whose height differs by more than this many standard deviations are left out."""
_UNEVEN_MM = 0.02
"""Standard deviation of the heights of places on a body, beside noise."""
_WEIGHT_ROUNDS = 4


_SIZES_PX = np.geomspace(0.004, 0.4, 21)
_WORST = -8.0
"""Least logarithm of the likelihood that one body contributes: a wrong one must not decide for all."""
_OWN = 0.5
"""Standard deviation of the logarithm of a body's own σ."""
_ROW_SHARE = 0.5
"""Share of the rows' standard deviation that two frames of one place do not have in common."""
_SCATTER_MM, _SCALE = 0.006, 0.002
"""Standard deviation of a body's shape, mm, and relative one of the working distance: 1 mm at 483 mm."""


class BodyEquations(NamedTuple):
    """Normal equations of a body for the error δ of its height and the displacement of each of its k pictures."""

    height_mm: float
    """The height at which the equations were linearised."""
    step_mm: float
    """First estimate of δ."""
    matrix: Floats
    """(1 + 2·k, 1 + 2·k)."""
    vector: Floats
    """(1 + 2·k,)."""
    scale: float
    """Pixels of a frame per pixel of the pictures."""
    unlike_mm: float = 0.0
    """Standard deviation by differences that all tiles have in common, such as glare."""


def combine(bodies: Mapping[str, BodyEquations], row_sigma_px: float) -> dict[str, tuple[float, float]]:
    """Return height and standard deviation of every body, mm.

    Args:
        bodies: the equations of all bodies of one run, by address.
        row_sigma_px: standard deviation of the rows' positions.
    """
    if not bodies:
        return {}
    tables = {ref: solve_at_sizes(b.matrix, b.vector, b.scale, _SIZES_PX)[:, 0] for ref, b in bodies.items()}
    tables = {address: table - table.max() for address, table in tables.items()}
    together = np.sum([np.maximum(table, _WORST) for table in tables.values()], axis=0)
    common = float(_SIZES_PX[int(np.argmax(together))])
    least = max(common, _ROW_SHARE * row_sigma_px)
    out = {}
    for address, body in bodies.items():
        own = tables[address] - (np.log(_SIZES_PX / least) / _OWN) ** 2 / 2
        size = max(float(_SIZES_PX[int(np.argmax(own))]), least)
        _, step_mm, own_variance = solve_at_sizes(body.matrix, body.vector, body.scale, np.array([size]))[0].tolist()
        # The equations belong to the height before the last step.
        mm = body.height_mm + step_mm
        variance = own_variance + body.unlike_mm**2 + _SCATTER_MM**2 + (_SCALE * mm) ** 2
        out[address] = mm, math.sqrt(variance)
    return out


@compiled
def solve_at_sizes(matrix: Floats, vector: Floats, scale: float, sizes_px: Floats) -> Floats:
    """Solve the equations of a body for n sizes of the displacements: their standard deviation is the prior.

    Returns (n, 3): the logarithm of the likelihood of the size, up to a constant, the height and its variance. The
    likelihood of a size for which the matrix is not positive definite is negligible.
    """
    m, n = len(vector), len(sizes_px)
    factor, right, out = np.empty((m, m)), np.empty(m), np.empty((n, 3))
    for s in range(n):
        added, log, fit, sound = (scale / sizes_px[s]) ** 2, 0.0, 0.0, True
        # Cholesky's elimination from the last unknown to the first, so that the last pivot is that of the height.
        for i in range(m - 1, -1, -1):
            for j in range(i, -1, -1):
                entry = matrix[i, j]
                if i == j:
                    entry += added if i else 1e-9
                for k in range(i + 1, m):
                    entry -= factor[k, i] * factor[k, j]
                if i == j:
                    sound = sound and entry > 0
                    factor[i, i] = math.sqrt(entry) if entry > 0 else 1.0
                else:
                    factor[i, j] = entry / factor[i, i]
            right[i] = vector[i]
            for k in range(i + 1, m):
                right[i] -= factor[k, i] * right[k]
            right[i] /= factor[i, i]
            log += 2 * math.log(factor[i, i])
            fit += right[i] ** 2
        out[s, 0] = (fit - log) / 2 - (m - 1) * math.log(sizes_px[s] / scale) if sound else -1e9
        out[s, 1], out[s, 2] = right[0] / factor[0, 0], 1 / factor[0, 0] ** 2
    return out
