"""Prediction of a pixel from the two rows above it: kinds of neighbourhoods, and weights for each of them.

No pixel depends on its own row, so that a decoder computes a row at once, in vector registers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.files.images import Image

KINDS = 8
"""Number of kinds of neighbourhoods, from flat to rough."""
WEIGHTS = 7
"""Weights of N, NW, NE, NN, NNW, NNE (compass directions from the pixel), and a constant."""
FRACTION_BITS = 12
"""Weights are whole multiples of 2⁻¹²."""
TOP = 2
"""Number of rows above a padded plane."""
MARGIN = 1
"""Margin of a padded plane on the left and on the right."""
GROUP = 8
"""The width of a padded plane is a multiple of this number of pixels, which are decoded in one step."""
_SAMPLED_ROWS = 64
_SAMPLED_PIXELS = 6_000
"""Number of rows to which the weights are fitted, and of pixels in them."""


class Model(NamedTuple):
    """How the pixels of one plane are predicted."""

    bounds: NDArray[np.uint16]
    """Largest activities of all kinds but the last (KINDS - 1,)."""
    weights: NDArray[np.int32]
    """Weights (2 · WEIGHTS,), times 2^FRACTION_BITS: those of kind 0, and what is added to them kind² times."""


class Context(NamedTuple):
    """What the rows above say of the pixels of a row, each (width,)."""

    kind: NDArray[np.uint16]
    """Kind of neighbourhood, times a unit."""
    guess: NDArray[np.uint16]
    """Predicted value, modulo 2^16."""


def empty_plane(shape: tuple[int, int], level: int) -> NDArray[np.uint16]:
    """Return a padded plane without its pixels; the rows above it have the value `level`."""
    height, width = shape
    out = np.empty((height + TOP, -(-width // GROUP) * GROUP + 2 * MARGIN), np.uint16)
    out[:TOP] = level
    return out


def padded(plane: Image) -> NDArray[np.uint16]:
    """Return a plane with what its neighbours are read from.

    Above it lies the mean of the first row, beside it and up to a full group the nearest pixel of the row.
    """
    width = plane.shape[1]
    out = empty_plane(plane.shape, int(plane[0].mean()))
    out[TOP:, :MARGIN] = plane[:, :1]
    out[TOP:, MARGIN : MARGIN + width] = plane
    out[TOP:, MARGIN + width :] = plane[:, -1:]
    return out


def fit(out: NDArray[np.uint16]) -> Model:
    """Fit kinds and weights to a padded plane."""
    rows = np.arange(TOP, len(out), max((len(out) - TOP) // _SAMPLED_ROWS, 1))
    sampled = _samples(out, rows, 1 + len(rows) * out.shape[1] // _SAMPLED_PIXELS)
    activities = sampled[:, WEIGHTS + 1]
    bounds = np.sort(activities)[np.arange(1, KINDS) * len(activities) // KINDS]
    kinds = np.searchsorted(bounds, activities).astype(np.float64)
    return Model(bounds.astype(np.uint16), _solve(sampled[:, : WEIGHTS + 1].astype(np.float64), kinds))


def _solve(sampled: NDArray[np.float64], kinds: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the weights of the least squares solution; the last column is the pixel itself."""
    factors = sampled[:, :WEIGHTS]
    terms = np.concatenate((factors, factors * (kinds * kinds)[:, None]), 1)
    # A small prior at the pixel above decides where a flat plane leaves the weights open.
    prior = np.zeros(2 * WEIGHTS)
    prior[0] = 1
    strength = 1e-3 * len(terms)
    normal = terms.T @ terms + strength * np.eye(2 * WEIGHTS)
    solution = np.linalg.solve(normal, terms.T @ sampled[:, WEIGHTS] + strength * prior)
    # Half a unit in the constant rounds the predicted value, of which the fraction is cut off.
    solution[WEIGHTS - 1] += 0.5
    weights: NDArray[np.int32] = np.clip(np.rint(solution * (1 << FRACTION_BITS)), -(2**30), 2**30).astype(np.int32)
    return weights


@inlined
def _distance(one, other):  # type: ignore[no-untyped-def]
    """Return how far two pixels differ, in 16 bits: twice as many fit into a vector register as of 32."""
    return np.uint16(max(one, other) - min(one, other))


@inlined
def _activity(n, nw, ne, nn, nnw, nne):  # type: ignore[no-untyped-def]
    """Return the activity of a neighbourhood, modulo 2^16."""
    return np.uint16(_distance(n, nw) + _distance(n, ne) + _distance(nn, n) + _distance(nnw, nw) + _distance(nne, ne))


@compiled
def _samples(out: NDArray[np.uint16], rows: NDArray[np.int64], every: int) -> NDArray[np.int32]:
    """Return neighbours, constant, pixel and activity of some pixels (n, WEIGHTS + 2)."""
    first, end = MARGIN, out.shape[1] - MARGIN
    found = np.empty((len(rows) * ((end - first + every - 1) // every), WEIGHTS + 2), np.int32)
    many = 0
    for y in rows:
        for x in range(first, end, every):
            n, nw, ne = out[y - 1, x], out[y - 1, x - 1], out[y - 1, x + 1]
            nn, nnw, nne = out[y - 2, x], out[y - 2, x - 1], out[y - 2, x + 1]
            one = found[many]
            one[0], one[1], one[2], one[3], one[4], one[5] = n, nw, ne, nn, nnw, nne
            one[6], one[7] = 1, out[y, x]
            one[8] = _activity(n, nw, ne, nn, nnw, nne)
            many += 1
    return found


@compiled
def fill_context(out: NDArray[np.uint16], p: int, stride: int, model: Model, unit: int, context: Context) -> None:
    """Fill the context of the row that begins at index `p` of a padded plane, which is given as one row of numbers."""
    kind, guess = context.kind, context.guess
    b, c, m, times = model.bounds, model.weights, kind.size, np.uint16(unit)
    n, nw, ne = out[p - stride :], out[p - stride - 1 :], out[p - stride + 1 :]
    nn, nnw, nne = out[p - 2 * stride :], out[p - 2 * stride - 1 :], out[p - 2 * stride + 1 :]
    b0, b1, b2, b3, b4, b5, b6 = b[0], b[1], b[2], b[3], b[4], b[5], b[6]
    # One loop for each width of numbers, so that vector registers are full.
    for k in range(m):
        a = _activity(n[k], nw[k], ne[k], nn[k], nnw[k], nne[k])
        low = np.uint16(a > b0) + np.uint16(a > b1) + np.uint16(a > b2) + np.uint16(a > b3)
        kind[k] = np.uint16(low + np.uint16(a > b4) + np.uint16(a > b5) + np.uint16(a > b6))
    n0, nw0, ne0, nn0, nnw0, nne0, one0 = c[0], c[1], c[2], c[3], c[4], c[5], c[6]
    n1, nw1, ne1, nn1, nnw1, nne1, one1 = c[7], c[8], c[9], c[10], c[11], c[12], c[13]
    # Sums are taken modulo 2^32, by the encoder as by the decoder.
    for k in range(m):
        square = np.int32(kind[k]) * np.int32(kind[k])
        d, e, f = np.int32(n[k]), np.int32(nw[k]), np.int32(ne[k])
        g, h, i = np.int32(nn[k]), np.int32(nnw[k]), np.int32(nne[k])
        flat = n0 * d + nw0 * e + ne0 * f + nn0 * g + nnw0 * h + nne0 * i + one0
        rise = n1 * d + nw1 * e + ne1 * f + nn1 * g + nnw1 * h + nne1 * i + one1
        guess[k] = np.uint16(np.int32(flat + square * rise) >> np.int32(FRACTION_BITS))
        kind[k] *= times
