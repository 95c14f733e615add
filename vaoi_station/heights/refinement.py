"""Normal equations of a height: how the pictures of a body differ after they were laid over one another.

All pictures of one group show one common picture T, each with its own gain, displaced by a·δ + d: a is the parallax
per mm, δ the error of the height, d the error of the frame's matrix at this place. Linearised, the difference of a
picture from T is −g·∇T·(a·δ + d), minus the mean of the group. The size of the d is estimated from all bodies of the
run together (restricted maximum likelihood), and for each body again with that as the prior.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats

Ints = NDArray[np.int_]


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


def normal_equations(
    stack: NDArray[np.float32], lean: Floats, tiles: Ints, used: NDArray[np.bool_], group: Ints
) -> Normals:
    """Compute the normal equations of every tile, for a variance of 1 per pixel.

    Args:
        stack: (k, h, w) pictures on the plane at the present height.
        lean: (t, k, 2) displacement of each picture at each tile, px per mm.
        tiles: (t, 4) first column, first row, width and height, which are the same for all.
        used: (t, k) which pictures show which tile.
        group: (k,) number of the group of each picture.
    """
    (t, k), (w, h) = used.shape, tiles[0, 2:].tolist()
    shown, grams = _grams(stack, tiles, used)
    # Between values of pictures, between values and gradients, and between gradients.
    values, mixed, slopes = grams[:, :k, :k], grams[:, :k, k:].reshape(t, k, k, 2), grams[:, k:, k:]
    slopes = slopes.reshape(t, k, 2, k, 2).swapaxes(2, 3)
    own = np.arange(k)
    matrix, noisy, vector = np.zeros((t, 1 + 2 * k, 1 + 2 * k)), np.zeros(t), np.zeros((t, 1 + 2 * k))
    squares, freedom = np.zeros(t), np.zeros(t)
    for number in set(group.tolist()):
        mine = shown & (group == number)
        count = mine.sum(1)
        # The gains are the first eigenvector of the Gram matrix, with a mean square of 1.
        gram = values * (mine[:, :, None] & mine[:, None])
        gain = np.linalg.eigh(gram)[1][..., -1] * np.sqrt(count)[:, None] * mine
        weight = gain**2
        all2, all4 = weight.sum(1), (weight**2).sum(1)
        cross = all2**2 - all4
        # One picture that is far brighter than the others leaves no product of two different ones.
        fit = (count >= 2) & (all2 > 0) & (cross >= 1e-3 * all2**2)
        all2, cross = np.where(fit, all2, 1)[:, None], np.where(fit, cross, 1)[:, None, None]
        gain, weight = gain * fit[:, None], weight * fit[:, None]
        share, part = gain / all2, weight / all2
        # The common picture is the sum of gain times picture, times share; `common` has its products with all others.
        common = (gram @ gain[..., None])[..., 0]
        difference = gram[:, own, own] - 2 * share * common + share**2 * (gain * common).sum(1, keepdims=True)
        squares += fit * (difference * mine).sum(1)
        freedom += fit * (w * h - 3) * (count - 1)
        along = (mixed * gain[:, None, :, None]).sum(2)
        slope = share[..., None] * (share[..., None] * (gain[..., None] * along).sum(1, keepdims=True) - along)
        outer = (slopes * (gain[:, :, None] * gain[:, None])[..., None, None]).sum((1, 2))
        # Products of the gradients of two different pictures: their noise is independent.
        product = (outer - (slopes[:, own, own] * weight[..., None, None]).sum(1)) / cross
        # Only displacements from the common picture show: the weighted mean of all is removed.
        away = lean - (part[..., None] * lean).sum(1, keepdims=True)
        pull = weight[..., None] * (away @ product)
        matrix[:, 0, 0] += (pull * away).sum((1, 2))
        matrix[:, 0, 1:] += pull.reshape(t, -1)
        between = -weight[:, :, None] * part[:, None]
        between[:, own, own] += weight
        both = between[:, :, None, :, None] * product[:, None, :, None]
        matrix[:, 1:, 1:] += both.reshape(t, 2 * k, 2 * k)
        vector[:, 0] += (away * slope).sum((1, 2))
        vector[:, 1:] += (slope - part[..., None] * slope.sum(1, keepdims=True)).reshape(t, -1)
        noisy += (weight[..., None] * (away @ outer) * away).sum((1, 2)) / all2[:, 0] ** 2
    matrix[:, 1:, 0] = matrix[:, 0, 1:]
    return Normals(matrix, noisy, vector, squares / np.maximum(freedom, 1))


def _grams(stack: NDArray[np.float32], tiles: Ints, used: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], Floats]:
    """Return which pictures (t, k) show a tile, and the products of its values and gradients (t, 3·k, 3·k).

    They are the values of the k pictures, and the gradients of each along x and y, without mean and slope: a
    displacement shows only in what remains. Pictures that do not show a tile count as 0.
    """
    (k, height, width), (w, h) = stack.shape, tiles[0, 2:].tolist()
    fields = np.zeros((3 * k, height, width), np.float32)
    fields[:k] = stack
    np.subtract(stack[:, :, 2:], stack[:, :, :-2], out=fields[k::2, :, 1:-1])
    np.subtract(stack[:, 2:], stack[:, :-2], out=fields[k + 1 :: 2, 1:-1])
    fields[k:] *= np.float32(0.5)
    first, pixels = (tiles[:, 1] * width + tiles[:, 0])[:, None], _pixels(w, h, width)
    found = fields.reshape(3 * k, -1)[:, first + pixels].swapaxes(0, 1).astype(np.float64)
    shown = used & np.isfinite(found[:, :k].sum(2) + found[:, k:].reshape(len(tiles), k, -1).sum(2))
    if not shown.all():
        found[~np.concatenate([shown, np.repeat(shown, 2, 1)], 1)] = 0
    flat = found @ _level(w, h)
    return shown, found @ found.swapaxes(1, 2) - flat @ flat.swapaxes(1, 2)


@lru_cache(maxsize=64)
def _pixels(w: int, h: int, width: int) -> Ints:
    """Return the numbers of the pixels of a tile, counted from its first one, in a picture of a width."""
    return (np.arange(h)[:, None] * width + np.arange(w)).ravel()


@lru_cache(maxsize=64)
def _level(w: int, h: int) -> Floats:
    """Return an orthonormal base (w · h, 3) of mean and slope of a tile."""
    y, x = np.mgrid[:h, :w].reshape(2, -1)
    return np.asarray(np.linalg.qr(np.stack([np.ones(w * h), x, y], -1))[0], np.float64)


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


def weigh_tiles(found: Normals, tiles: Ints, lowest: float, edge_mm: float) -> TileEquations:
    """Divide the equations of every tile by its variance, which accounts for noise, misfit and edges.

    Args:
        found: the equations for a variance of 1 per pixel.
        tiles: (t, 4) tiles on the body.
        lowest: least variance of a pixel.
        edge_mm: standard deviation of the error that tiles at edges have in common; see `edge_weights`.
    """
    # The value above which nine tenths lie.
    some = np.sort(found.variance[found.variance > 0])
    at = 0.1 * (len(some) - 1)
    floor = max(float(some[int(at)] + at % 1 * (some[math.ceil(at)] - some[int(at)])), lowest)
    misfit, texture = np.maximum(found.variance - 3 * floor, 0), found.matrix[:, 0, 0]
    variance = np.maximum(found.variance, floor) * NOISE_AREA + misfit * _MISFIT_AREA
    information = np.maximum(texture, 0) / variance
    factor = edge_weights(tiles, information, edge_mm)
    share = factor / variance
    worth = factor * information
    unlike = (worth * np.sqrt(misfit * tiles[:, 2] * tiles[:, 3] / np.maximum(texture, 1e-3))).sum()
    return TileEquations(
        found.matrix * share[:, None, None],
        found.vector * share[:, None],
        found.noisy * share,
        _COMMON * float(unlike / max(worth.sum(), 1e-9)),
    )


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
    at = tiles[:, :2]
    outer = ((at == at.min(0)) | (at == at.max(0))).any(1)
    count, at_edges = int(outer.sum()), float(information @ outer)
    texture = (float(information.sum()) - at_edges) / max(len(outer) - count, 1) * count
    share = min(max(1 - texture / max(at_edges, 1e-12), 0.0), 1.0)
    return np.where(outer, 1 / (1 + at_edges * (share * sigma_mm) ** 2), 1.0)


def add_up(tiles: TileEquations, weight: Floats) -> Sum:
    """Add up the equations of tiles with these weights (t,), some of which are not 0."""
    t, m = tiles.vector.shape
    n, b = (weight @ tiles.matrix.reshape(t, -1)).reshape(m, m), weight @ tiles.vector
    held = n.copy()
    held.flat[:: m + 1] += 1 / _DISPLACED_PX**2
    held[0, 0] = n[0, 0] + 1e-9
    theta = np.linalg.solve(held, b)
    off = tiles.vector[:, 0] - tiles.matrix[:, 0] @ theta
    total = weight.sum()
    scatter = weight @ (off**2 / (tiles.noisy + 1e-12))
    inflation = weight @ tiles.noisy / n[0, 0] * max(1.0, scatter / max(total - 1, 1.0))
    # The sum of the tiles' own deviations is the variance of the sum, however unlike the tiles are (sandwich).
    count = total**2 / (weight**2).sum()
    inflation = max(inflation, np.square(weight * off).sum() / n[0, 0] * count / max(count - 1, 1.0))
    return Sum(float(theta[0]), n / inflation, b / inflation)


def tile_weights(matrix: Floats, vector: Floats, noisy: Floats) -> Floats:
    """Compute the weights (t,) of t tiles, from 0 to 1, around the height that most of them have (Tukey's biweight).

    All are 0 if the tiles have no texture.

    Args:
        matrix: (t, p, p) normal matrices of the tiles, divided by their variances; the first parameter is the height.
        vector: (t, p) right sides of their normal equations.
        noisy: (t,) information on the height that noise alone would add.
    """
    own = np.maximum(matrix[:, 0, 0], 1e-3 * noisy + 1e-12)
    mm, sigma = vector[:, 0] / own, np.sqrt(noisy / own**2 + _UNEVEN_MM**2)
    # A few tiles may show a lead, a fillet of solder or a neighbour, most often lower than the body.
    order = np.argsort(mm, kind="stable")
    below = np.cumsum(sigma[order] ** -2)
    centre = mm[order[np.searchsorted(below, below[-1] / 2)]]
    weight = np.zeros(len(mm))
    for _ in range(_WEIGHT_ROUNDS):
        weight = np.maximum(1 - np.square((mm - centre) / (_TIGHT * sigma)), 0) ** 2
        texture = weight @ matrix[:, 0, 0]
        if texture <= _INFORMED * (weight @ noisy) or texture <= 0:
            return np.zeros(len(mm))
        centre = weight @ vector[:, 0] / texture
    return weight


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


def solve_at_sizes(matrix: Floats, vector: Floats, scale: float, sizes_px: Floats) -> Floats:
    """Solve the equations of a body for n sizes of the displacements: their standard deviation is the prior.

    Returns (n, 3): the logarithm of the likelihood of the size, up to a constant, the height and its variance. The
    likelihood of a size for which the matrix is not positive definite is negligible.
    """
    prior = np.ones((len(sizes_px), len(vector))) * ((scale / sizes_px) ** 2)[:, None]
    prior[:, 0] = 1e-9
    values, vectors = np.linalg.eigh(matrix + prior[:, None] * np.eye(len(vector)))
    sound = values[:, 0] > 0
    values = np.where(sound[:, None], values, 1)
    along, height = vector @ vectors, vectors[:, 0]
    likelihood = ((along**2 / values).sum(1) - np.log(values).sum(1)) / 2 - (len(vector) - 1) * np.log(sizes_px / scale)
    mm, variance = (along * height / values).sum(1), (height**2 / values).sum(1)
    return np.stack([np.where(sound, likelihood, -1e9), mm, variance], -1)
