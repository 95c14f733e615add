"""Compiled: the equations of the tiles of a body, divided by their variances, and their sum.

A body has few tiles and few pictures. As calls of numpy, these sums would take as long as the pictures themselves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.small_sorts import ascending
from vaoi_station.geometry.transforms import Floats
from vaoi_station.heights.refinement import Ints, Normals

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
