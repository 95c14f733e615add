"""Which tiles of a footprint lie on the body, and how probable each height of the body is.

How much of the footprint the body covers is not in the CAD data: leads, pads and bare board may surround it. Therefore
extents are compared: rectangles in the footprint, each with a prior probability. Tiles inside the extent see the body's
height, tiles outside see the board, tiles across an edge see either or a mixture. The probability of a height is the
sum over all extents (as `stitching.quality.heights.body_heights` does it with links).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.body_extents import EXTENTS
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


class Levels(NamedTuple):
    """The probability of each height and, for the most probable one, of each tile to lie on the body."""

    probability: Floats
    """(n,) probabilities of n heights; their sum is 1."""
    on_body: Floats
    """(t,) probability of each tile to see the body at the most probable height."""


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
    # A sum of squares; pictures that are equal leave less than zero by rounding.
    sums, freedom = np.maximum(found.sums, 0), found.freedom[:, None]
    alike = sums <= _ALIKE * sums.min(1, keepdims=True)
    noise = (sums * alike).sum(1) / alike.sum(1) / found.freedom
    # Tiles at edges have more than noise: on a body between leads, they are most of all tiles.
    noise = np.maximum(noise, max(float(np.sort(noise)[len(noise) // 4]), 1e-3))
    # The texture is a difference of logarithms: about that of the variance of one picture.
    own = noise[:, None] + unlike * np.exp(found.texture / freedom)
    ratio = sums / (own * freedom)
    misfit = np.maximum(ratio, 1) - 1 - np.log(np.maximum(ratio, 1))
    # Logarithm of the likelihood of a common picture, relative to that of pictures with nothing in common.
    texture = found.texture + freedom * (1 - np.log(own) - ratio)
    log = np.clip(texture / (2 * noise_area), 0, _TEXTURE) - freedom * misfit / (2 * noise_area)
    likelihood = np.exp(log - log.max(1, keepdims=True))
    return likelihood, likelihood[:, at_board].max(1)


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
    log_extent, touched, within = _extents(tuple(size.tolist()), tiles.tobytes())
    everywhere = likelihood.mean(1, keepdims=True)
    raised = np.where(heights_mm > 0, likelihood, 0).cumsum(1)
    between = (board[:, None] + raised) / (1 + (heights_mm > 0).cumsum())
    match = _INSIDE * likelihood
    stray = _STRAY * everywhere
    inside = match + _BELOW * between + stray
    # A tile is outside, or across an edge, or inside; the logarithms of the first are those of all tiles.
    outside, edge, own = np.log(
        np.stack(
            [_OUTSIDE * board[:, None] + _LEAD * between + _ASTRAY * everywhere, _ACROSS * between + stray, inside]
        )
        + 1e-12
    )
    evidence = touched @ (edge - outside) + within @ (own - edge) + (outside.sum(0) + log_prior)
    weight = np.exp(evidence + (log_extent - (evidence + log_extent).max()))
    probability = weight.sum(0)
    best = int(probability.argmax())
    share = (weight[:, best] / probability[best]) @ within
    on_body = share * match[:, best] / (inside[:, best] + 1e-300)
    return Levels(probability / probability.sum(), on_body)


@lru_cache(maxsize=256)
def _extents(size: tuple[int, int], packed_tiles: bytes) -> tuple[Floats, Floats, Floats]:
    """Return k extents of a body in a footprint with t tiles: the logarithms of their probabilities (k, 1), and which
    tiles each touches and contains (k, t). Components of one size have the same tiles.
    """
    tiles = np.frombuffer(packed_tiles, np.int_).reshape(-1, 4)
    (across, prior_x), (down, prior_y) = (_sides(tiles, size[axis], axis) for axis in range(2))
    # A tile is outside if it is outside along one axis, and inside if it is inside along both.
    where = np.minimum(across[:, None], down).reshape(-1, len(tiles))
    return np.log(np.outer(prior_x, prior_y)).reshape(-1, 1), (where > 0).astype(float), (where > 1).astype(float)


def _sides(tiles: Ints, size: int, axis: int) -> tuple[Ints, Floats]:
    """Return whether tiles lie outside (0), across (1) or inside (2) each extent along an axis, (k, t).

    Extents with the same tiles on each side are one, since a component has few tiles; also return the probability (k,)
    of each.
    """
    half = size / 2
    low, high = (half - 0.5 + sign * EXTENTS[:, n, None] * half for n, sign in ((0, -1), (1, 1)))
    first, end = tiles[:, axis] - 0.5 + _EDGE_PX, tiles[:, axis] + tiles[:, 2 + axis] - 0.5 - _EDGE_PX
    sides = np.where((first >= low) & (end <= high), 2, np.where((end <= low) | (first >= high), 0, 1))
    found, same = np.unique(sides, axis=0, return_inverse=True)
    return found, np.bincount(same.ravel(), EXTENTS[:, 2]).astype(np.float64)
