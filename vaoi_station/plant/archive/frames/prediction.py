"""Prediction of a pixel from neighbours that come before it: kinds of neighbourhoods, and weights for each of them.

All but the weighted left neighbour depends on the rows above only, and is computed for a row at a time: what is left to
do for one pixel after the other is what limits a decoder.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.files.images import Image

KINDS = 8
"""Number of kinds of neighbourhoods, from flat to rough."""
FIRST_ROWS = KINDS
"""Kind of the first rows, which have no neighbours above: a pixel is predicted to be as the one on its left."""
BLIND_ROWS = 2
"""Number of these rows."""
WEIGHTS = 7
"""Weights of W, N, NW, NE, NN, NNE (compass directions from the pixel), and a constant."""
FRACTION_BITS = 12
"""Weights are whole multiples of 2⁻¹²."""
ACTIVITIES = 1024
"""Number of steps of the activity of a neighbourhood, from which its kind follows."""
MARGIN = 1
"""Margin of a padded plane on the left and on the right."""
_SAMPLED_ROWS = 64
_SAMPLED_PIXELS = 10_000
"""Number of rows to which the weights are fitted, and of pixels in them."""
_index = np.uint64
"""Index as an unsigned number: a signed one is checked for counting from the end, at every access."""


class Model(NamedTuple):
    """How the pixels of one plane are predicted."""

    shift: int
    """Bits by which activities are reduced to ACTIVITIES steps."""
    kinds: NDArray[np.uint8]
    """Kind of neighbourhood by its activity (ACTIVITIES,)."""
    weights: NDArray[np.int32]
    """Weights (2 · WEIGHTS,), times 2^FRACTION_BITS: those of kind 0, and what is added to them kind² times."""


class Context(NamedTuple):
    """What the rows above say of the pixels of a row, each (width,)."""

    kind: NDArray[np.uint16]
    """Kind of neighbourhood."""
    left: NDArray[np.int32]
    """Weight of the left neighbour."""
    above: NDArray[np.int32]
    """Weighted sum of the other neighbours and the constant."""


def new_context(width: int) -> Context:
    """Return the context of the first rows."""
    left = np.full(width, 1 << FRACTION_BITS, np.int32)
    return Context(np.full(width, FIRST_ROWS, np.uint16), left, np.zeros(width, np.int32))


def padded_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the shape of a plane with margins, and with the rows that make two equal strips."""
    height, width = shape
    return height + height % 2, width + 2 * MARGIN


def padded(plane: Image) -> NDArray[np.uint16]:
    """Return a plane of two equal strips with the margins that neighbours are read from.

    Left of a row is the first pixel of the row above, right of it its own last pixel. The first row of a strip has a
    zero on the left. A row that is missing in the lower strip repeats the last one.
    """
    height, width = plane.shape
    out = np.zeros(padded_shape(plane.shape), np.uint16)
    out[:height, 1 : width + 1] = plane
    out[height:] = out[height - 1]
    out[:, -1] = out[:, -2]
    half = len(out) // 2
    for strip in (out[:half], out[half:]):
        strip[1:, 0] = strip[:-1, 1]
    return out


def fit(out: NDArray[np.uint16]) -> Model:
    """Fit kinds and weights to a padded plane."""
    # An activity is the sum of five differences, most of them far below the largest value.
    shift = max(int(out.max()).bit_length() - 8, 0)
    rows = np.arange(BLIND_ROWS, len(out), max((len(out) - BLIND_ROWS) // _SAMPLED_ROWS, 1))
    every = 1 + len(rows) * out.shape[1] // _SAMPLED_PIXELS
    sampled = _samples(out, rows, every)
    steps = np.minimum(sampled[:, WEIGHTS + 1] >> shift, ACTIVITIES - 1)
    share = np.cumsum(np.bincount(steps, minlength=ACTIVITIES))
    kinds = np.clip((share - 1) * KINDS // max(int(share[-1]), 1), 0, KINDS - 1).astype(np.uint8)
    return Model(shift, kinds, _solve(sampled[:, : WEIGHTS + 1].astype(np.float64), kinds[steps].astype(np.float64)))


def _solve(sampled: NDArray[np.float64], kinds: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the weights of the least squares solution; the last column is the pixel itself."""
    factors = sampled[:, :WEIGHTS]
    terms = np.concatenate((factors, factors * (kinds * kinds)[:, None]), 1)
    # A small prior at equal weights of W and N decides where a flat plane leaves the weights open.
    prior = np.zeros(2 * WEIGHTS)
    prior[:2] = 0.5
    strength = 1e-3 * max(len(terms), 1)
    normal = terms.T @ terms + strength * np.eye(2 * WEIGHTS)
    solution = np.linalg.solve(normal, terms.T @ sampled[:, WEIGHTS] + strength * prior)
    # Half a unit in the constant rounds the predicted value, of which the fraction is cut off.
    solution[WEIGHTS - 1] += 0.5
    weights: NDArray[np.int32] = np.clip(np.rint(solution * (1 << FRACTION_BITS)), -(2**30), 2**30).astype(np.int32)
    return weights


@inlined
def _roughness(n, nw, ne, nn, nnw, nne):  # type: ignore[no-untyped-def]
    """Return the activity of a neighbourhood."""
    return abs(n - nw) + abs(n - ne) + abs(nn - n) + abs(nnw - nw) + abs(nne - ne)


@compiled
def _samples(out: NDArray[np.uint16], rows: NDArray[np.int64], every: int) -> NDArray[np.int32]:
    """Return neighbours, constant, pixel and activity of some pixels (n, WEIGHTS + 2)."""
    first, end = MARGIN, out.shape[1] - MARGIN
    found = np.empty((len(rows) * ((end - first + every - 1) // every), WEIGHTS + 2), np.int32)
    many = 0
    for y in rows:
        for x in range(first, end, every):
            n, nw, ne = np.int32(out[y - 1, x]), np.int32(out[y - 1, x - 1]), np.int32(out[y - 1, x + 1])
            nn, nnw, nne = np.int32(out[y - 2, x]), np.int32(out[y - 2, x - 1]), np.int32(out[y - 2, x + 1])
            one = found[many]
            one[0], one[1], one[2], one[3], one[4], one[5] = out[y, x - 1], n, nw, ne, nn, nne
            one[6], one[7] = 1, out[y, x]
            one[8] = _roughness(n, nw, ne, nn, nnw, nne)
            many += 1
    return found


@compiled
def fill_context(out: NDArray[np.uint16], p: int, stride: int, model: Model, context: Context) -> None:
    """Fill the context of the row that begins at index `p` of a padded plane, which is given as one row of numbers."""
    shift, top = np.int32(model.shift), np.int32(ACTIVITIES - 1)
    kind_of, c = model.kinds, model.weights
    kind, left, above = context.kind, context.left, context.above
    m = kind.size
    n, nw, ne = out[p - stride :], out[p - stride - 1 :], out[p - stride + 1 :]
    nn, nnw, nne = out[p - 2 * stride :], out[p - 2 * stride - 1 :], out[p - 2 * stride + 1 :]
    # One loop for each quantity, so that the compiler uses vector registers where it can.
    for k in range(m):
        rough = _roughness(
            np.int32(n[k]), np.int32(nw[k]), np.int32(ne[k]), np.int32(nn[k]), np.int32(nnw[k]), np.int32(nne[k])
        )
        kind[k] = np.uint16(min(rough >> shift, top))
    for k in range(m):
        kind[k] = kind_of[_index(kind[k])]
    w0, n0, nw0, ne0, nn0, nne0, one0 = c[0], c[1], c[2], c[3], c[4], c[5], c[6]
    w1, n1, nw1, ne1, nn1, nne1, one1 = c[7], c[8], c[9], c[10], c[11], c[12], c[13]
    # Sums are taken modulo 2^32, by the encoder as by the decoder.
    for k in range(m):
        square = np.int32(kind[k]) * np.int32(kind[k])
        a, b, d = np.int32(n[k]), np.int32(nw[k]), np.int32(ne[k])
        e, f = np.int32(nn[k]), np.int32(nne[k])
        flat = n0 * a + nw0 * b + ne0 * d + nn0 * e + nne0 * f + one0
        rise = n1 * a + nw1 * b + ne1 * d + nn1 * e + nne1 * f + one1
        above[k] = np.int32(flat + square * rise)
        left[k] = np.int32(w0 + square * w1)
