"""Which tiles of a footprint lie on the body, and how probable each height of the body is.

How much of the footprint the body covers is not in the CAD data: leads, pads and bare board may surround it. Therefore
extents are compared: rectangles in the footprint, each with a prior probability. Tiles inside the extent see the body's
height, tiles outside see the board, tiles across an edge see either or a mixture. The probability of a height is the
sum over all extents (as `stitching.quality.body_heights` does it with links).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.body_extents import EXTENTS
from vaoi_station.geometry.small_sorts import ascending
from vaoi_station.geometry.transforms import Floats
from vaoi_station.heights.sweep import Sweep

Ints = NDArray[np.int_]
_INSIDE, _BELOW, _STRAY = 0.84, 0.08, 0.08
"""Probabilities that a tile inside the extent sees the body's height, a lower place, or anything."""
_OUTSIDE, _LEAD, _ASTRAY = 0.82, 0.1, 0.08
"""Probabilities that a tile outside the extent sees the board, a lead, or anything."""
_EDGE_PX = 1.0
"""A tile that reaches over an edge by less than this counts as on one side."""
_ACROSS = 0.5
"""Weight of a tile across an edge of the extent, which sees any height from 0 to that of the body."""
_ALIKE = 1.5
"""Heights at which a tile fits up to this factor as well as at its best one show its noise."""
_TEXTURE = 3.5
"""Most that texture which fits at a height counts for it, as a logarithm."""
_NEGLIGIBLE = 40.0
"""Explanations less probable than the best one by this, as a logarithm, are left out."""


class Levels(NamedTuple):
    """The probability of each height and, for the most probable one, of each tile to lie on the body."""

    probability: Floats
    """(n,) probabilities of n heights; their sum is 1."""
    on_body: Floats
    """(t,) probability of each tile to see the body at the most probable height."""


@compiled
def compare_heights(
    found: Sweep, at_board: NDArray[np.bool_], noise_area: float, unlike: float
) -> tuple[Floats, Floats]:
    """Compute the likelihood of n heights by each of t tiles (t, n), and of the board's level (t,).

    At each height a tile compares other pixels. So a smaller sum than noise leaves is chance and no evidence, and a
    larger one has the probability of a variance that was estimated from few values (χ²). Where pictures have texture
    and still fit, they speak for the height, but not more than `_TEXTURE`: edges of bodies are alike, and one edge fits
    another. The largest likelihood of each tile is 1.

    Args:
        found: the sweep over the heights; every tile has degrees of freedom.
        at_board: (n,) which heights count as the board's level; at least one does.
        noise_area: number of pixels that share one independent value of noise.
        unlike: share of the texture's variance that two pictures of one place do not have in common.
    """
    sums, freedom = found.sums, found.freedom
    t, n = sums.shape
    noise = np.empty(t)
    for i in range(t):
        least = sums[i, 0]
        for m in range(n):
            least = min(least, sums[i, m])
        total, count = 0.0, 0
        for m in range(n):
            if sums[i, m] <= _ALIKE * least:
                total += sums[i, m]
                count += 1
        noise[i] = total / count / freedom[i]
    # Tiles at edges have more than noise: on a body between leads, they are most of all tiles.
    typical = max(noise[ascending(noise)[t // 4]], 1e-3)
    likelihood, board = np.empty((t, n)), np.zeros(t)
    for i in range(t):
        variance, most = max(noise[i], typical), -np.inf
        for m in range(n):
            # The texture is a difference of logarithms: about that of the variance of one picture.
            own = variance + unlike * math.exp(found.texture[i, m] / freedom[i]) if unlike > 0 else variance
            ratio = sums[i, m] / (own * freedom[i])
            misfit = ratio - 1 - math.log(ratio) if ratio > 1 else 0.0
            # Logarithm of the likelihood of a common picture, relative to that of pictures with nothing in common.
            texture = found.texture[i, m] + freedom[i] * (1 - math.log(own) - ratio)
            gain = min(max(texture / (2 * noise_area), 0.0), _TEXTURE)
            likelihood[i, m] = gain - freedom[i] * misfit / (2 * noise_area)
            most = max(most, likelihood[i, m])
        for m in range(n):
            likelihood[i, m] = math.exp(likelihood[i, m] - most)
            if at_board[m]:
                board[i] = max(board[i], likelihood[i, m])
    return likelihood, board


@compiled
def find_levels(
    likelihood: Floats, board: Floats, heights_mm: Floats, tiles: Ints, size: Ints, log_prior: Floats
) -> Levels:
    """Compute the probability of each height of the body.

    Args:
        likelihood: (t, n) likelihood of n heights by each of t tiles; the largest of each tile is 1.
        board: (t,) likelihood of the board's level by each tile.
        heights_mm: (n,) the heights, ascending.
        tiles: (t, 4) first column, first row, width and height of the tiles.
        size: (2,) width and height of the footprint, px.
        log_prior: (n,) logarithm of the prior probability of each height.
    """
    t, n, k = likelihood.shape[0], likelihood.shape[1], len(EXTENTS)
    side, log, inside = np.empty((2, k, t), np.int64), np.empty((n, 3, t)), np.empty((n, t))
    prior, count = np.zeros((2, k)), np.zeros(2, np.int64)
    for axis in range(2):
        count[axis] = _sort_tiles(tiles, size[axis], axis, side[axis], prior[axis])
    _tile_likelihoods(likelihood, board, heights_mm, log, inside)
    evidence = np.empty((n, count[0], count[1]))
    extent = np.empty((count[0], count[1]))
    for a in range(count[0]):
        for b in range(count[1]):
            extent[a, b] = math.log(prior[0, a] * prior[1, b])
    highest = _evidence(log, side, tiles, extent, evidence, log_prior)
    probability, everything, best = np.zeros(n), 0.0, 0
    for m in range(n):
        for a in range(count[0]):
            for b in range(count[1]):
                if evidence[m, a, b] > highest - _NEGLIGIBLE:
                    probability[m] += math.exp(evidence[m, a, b] - highest)
        everything += probability[m]
        best = m if probability[m] > probability[best] else best
    on_body = np.zeros(t)
    for a in range(count[0]):
        for b in range(count[1]):
            if evidence[best, a, b] <= highest - _NEGLIGIBLE:
                continue
            share = math.exp(evidence[best, a, b] - highest) / probability[best]
            for i in range(t):
                on_body[i] += share * inside[best, i] * (min(side[0, a, i], side[1, b, i]) == 2)
    for m in range(n):
        probability[m] /= everything
    return Levels(probability, on_body)


@inlined
def _evidence(log: Floats, side: Ints, tiles: Ints, extent: Floats, evidence: Floats, log_prior: Floats) -> float:
    """Write the logarithm of the probability of each height and extent to `evidence` (n, a, b); return the largest.

    `extent` (a, b) is the logarithm of the prior probability of each extent.

    A tile is outside if it is outside along one axis, and inside if it is inside along both. The tiles of one strip are
    on one side along the second axis, so that their sums serve all extents along it.
    """
    n, highest = log.shape[0], -np.inf
    first, strips = _strips(tiles)
    part = np.empty((strips, 3))
    for m in range(n):
        for a in range(evidence.shape[1]):
            for s in range(strips):
                for where in range(3):
                    part[s, where] = 0.0
                    for i in range(first[s], first[s + 1]):
                        part[s, where] += log[m, min(side[0, a, i], where), i]
            for b in range(evidence.shape[2]):
                total = extent[a, b] + log_prior[m]
                for s in range(strips):
                    total += part[s, side[1, b, first[s]]]
                evidence[m, a, b] = total
                highest = max(highest, total)
    return float(highest)


@inlined
def _strips(tiles: Ints) -> tuple[Ints, int]:
    """Return the number of the first tile of each strip, followed by the number of tiles, and the number of strips.

    A strip is a sequence of tiles with the same rows.
    """
    first, strips = np.empty(len(tiles) + 1, np.int64), 0
    for i in range(len(tiles)):
        if i == 0 or tiles[i, 1] != tiles[i - 1, 1] or tiles[i, 3] != tiles[i - 1, 3]:
            first[strips] = i
            strips += 1
    first[strips] = len(tiles)
    return first, strips


@inlined
def _sort_tiles(tiles: Ints, size: int, axis: int, side: Ints, prior: Floats) -> int:
    """Write to `side` (k, t) whether tiles lie outside (0), across (1) or inside (2) each extent along an axis.

    Extents with the same tiles on each side are one, since a component has few tiles: `prior` (k,) gets the
    probability of each. Return how many there are.
    """
    half, count = size / 2, 0
    for e in range(len(EXTENTS)):
        low, high = half - 0.5 - EXTENTS[e, 0] * half, half - 0.5 + EXTENTS[e, 1] * half
        for i in range(len(tiles)):
            first, length = tiles[i, axis], tiles[i, 2 + axis]
            a, b = first - 0.5 + _EDGE_PX, first + length - 0.5 - _EDGE_PX
            side[count, i] = 2 if a >= low and b <= high else 0 if b <= low or a >= high else 1
        same, equal = 0, 0
        while equal < len(tiles):
            equal = 0
            while equal < len(tiles) and side[same, equal] == side[count, equal]:
                equal += 1
            same += equal < len(tiles)
        prior[same] += EXTENTS[e, 2]
        count += same == count
    return count


@inlined
def _tile_likelihoods(likelihood: Floats, board: Floats, heights_mm: Floats, log: Floats, inside: Floats) -> None:
    """Compute the likelihood of each tile at each height of the body.

    Args:
        likelihood: (t, n) likelihood of the heights.
        board: (t,) likelihood of the board's level.
        heights_mm: (n,) the heights.
        log: (n, 3, t) output: logarithm of the likelihood of a tile outside, across an edge, or inside.
        inside: (n, t) output: probability that a tile inside sees the body's height.
    """
    t, n = likelihood.shape
    for i in range(t):
        everywhere = 0.0
        for m in range(n):
            everywhere += likelihood[i, m] / n
        between, count = board[i], 1
        for m in range(n):
            if heights_mm[m] > 0:
                between += likelihood[i, m]
                count += 1
            mean = between / count
            match = _INSIDE * likelihood[i, m]
            total = match + _BELOW * mean + _STRAY * everywhere
            inside[m, i] = match / (total + 1e-300)
            log[m, 2, i] = math.log(total + 1e-12)
            log[m, 1, i] = math.log(_ACROSS * mean + _STRAY * everywhere + 1e-12)
            log[m, 0, i] = math.log(_OUTSIDE * board[i] + _LEAD * mean + _ASTRAY * everywhere + 1e-12)
