"""Prediction of a pixel from neighbours that come before it: kinds of neighbourhoods, and weights for each of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.files.images import Image

KINDS = 8
"""Number of kinds of neighbourhoods, from flat to rough."""
FIRST_ROWS = KINDS
"""Kind of the first rows, which have no neighbours above: a pixel is predicted to be as the one on its left."""
WEIGHTS = 5
"""Weights of W, N, NW, NE (compass directions from the pixel), and a constant."""
FRACTION_BITS = 12
"""Weights are whole multiples of 2⁻¹²."""
ACTIVITIES = 1024
"""Number of steps of the activity of a neighbourhood, from which its kind follows."""
MARGIN = 2
"""Margin on the left of a padded plane, in steps; on the right it is one step."""
_SAMPLED_ROWS = 64
"""Number of rows to which the weights are fitted."""


class Model(NamedTuple):
    """How the pixels of one plane are predicted."""

    step: int
    """Distance of the neighbours in px: 2 where neighbours have filters of different colours."""
    largest: int
    """Largest value of a pixel."""
    shift: int
    """Bits by which activities are reduced to ACTIVITIES steps."""
    kinds: NDArray[np.uint8]
    """Kind of neighbourhood by its activity (ACTIVITIES,)."""
    weights: NDArray[np.int64]
    """Weights (KINDS · WEIGHTS,), times 2^FRACTION_BITS."""


def shift_of(largest: int) -> int:
    """Return the bits by which activities, sums of four differences, are reduced to ACTIVITIES steps."""
    return max(largest.bit_length() - 8, 0)


def padded_shape(shape: tuple[int, int], step: int) -> tuple[int, int]:
    """Return the shape of a plane with margins, and with the rows that make two equal strips."""
    height, width = shape
    return -(-height // (2 * step)) * 2 * step, width + (MARGIN + 1) * step


def padded(plane: Image, step: int) -> NDArray[np.uint16]:
    """Return a plane of two equal strips with the margins that neighbours are read from.

    Left of a row are the first pixels of the row above, right of it its own last pixels. The first rows of a strip have
    zeros on the left. Rows that are missing in the lower strip repeat the last ones.
    """
    height, width = plane.shape
    left = MARGIN * step
    out = np.zeros(padded_shape(plane.shape, step), np.uint16)
    out[:height, left : left + width] = plane
    for row in range(height, len(out)):
        out[row] = out[max(row - step, 0)]
    out[:, -step:] = out[:, -2 * step : -step]
    half = len(out) // 2
    for strip in (out[:half], out[half:]):
        strip[step:, :left] = np.tile(strip[:-step, left : left + step], MARGIN)
    return out


def fit(out: NDArray[np.uint16], step: int) -> Model:
    """Fit kinds and weights to a padded plane."""
    largest = int(out.max())
    shift = shift_of(largest)
    rows = np.arange(2 * step, len(out), max((len(out) - 2 * step) // _SAMPLED_ROWS, 1))
    share = np.cumsum(_activities(out, rows, step, shift))
    kinds = np.clip((share - 1) * KINDS // max(int(share[-1]), 1), 0, KINDS - 1).astype(np.uint8)
    weights = np.concatenate([_solve(sums) for sums in _normal_equations(out, rows, step, shift, kinds)])
    return Model(step, largest, shift, kinds, weights)


def _solve(sums: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the weights of the least squares solution; the last row of the equations is the pixel itself."""
    normal = sums[:WEIGHTS, :WEIGHTS].astype(np.float64)
    # A small prior at equal weights of W and N decides where a flat plane leaves the weights open.
    prior = np.zeros(WEIGHTS)
    prior[:2] = 0.5
    strength = 1e-3 * max(float(normal[WEIGHTS - 1, WEIGHTS - 1]), 1.0)
    solution = np.linalg.solve(normal + strength * np.eye(WEIGHTS), sums[WEIGHTS, :WEIGHTS] + strength * prior)
    # Half a unit in the constant rounds the predicted value, of which the fraction is cut off.
    solution[WEIGHTS - 1] += 0.5
    weights: NDArray[np.int64] = np.clip(np.rint(solution * (1 << FRACTION_BITS)), -(2**30), 2**30).astype(np.int64)
    return weights


@compiled
def _activities(out: NDArray[np.uint16], rows: NDArray[np.int64], step: int, shift: int) -> NDArray[np.int64]:
    """Count the activities of the pixels of some rows (ACTIVITIES,)."""
    counts = np.zeros(ACTIVITIES, np.int64)
    for y in rows:
        for x in range(2 * step, out.shape[1] - step):
            n, nw = np.int64(out[y - step, x]), np.int64(out[y - step, x - step])
            ne, nn = np.int64(out[y - step, x + step]), np.int64(out[y - 2 * step, x])
            rough = abs(n - nw) + abs(n - ne) + abs(np.int64(out[y, x - 2 * step]) - nw) + abs(nn - n)
            counts[min(rough >> shift, np.int64(ACTIVITIES - 1))] += 1
    return counts


@compiled
def _normal_equations(
    out: NDArray[np.uint16], rows: NDArray[np.int64], step: int, shift: int, kinds: NDArray[np.uint8]
) -> NDArray[np.int64]:
    """Sum the products of neighbours, constant and pixel by kind (KINDS, WEIGHTS + 1, WEIGHTS + 1), lower halves."""
    sums = np.zeros((KINDS, WEIGHTS + 1, WEIGHTS + 1), np.int64)
    for y in rows:
        for x in range(2 * step, out.shape[1] - step):
            w, n, nw = np.int64(out[y, x - step]), np.int64(out[y - step, x]), np.int64(out[y - step, x - step])
            ne, here = np.int64(out[y - step, x + step]), np.int64(out[y, x])
            ww, nn = np.int64(out[y, x - 2 * step]), np.int64(out[y - 2 * step, x])
            rough = abs(n - nw) + abs(n - ne) + abs(ww - nw) + abs(nn - n)
            kind = kinds[min(rough >> shift, np.int64(ACTIVITIES - 1))]
            # A tuple and no array: the compiler unrolls the loops and keeps the numbers in registers.
            v = (w, n, nw, ne, np.int64(1), here)
            for a in range(WEIGHTS + 1):
                for b in range(a + 1):
                    sums[kind, a, b] += v[a] * v[b]
    for kind in range(KINDS):
        for a in range(WEIGHTS + 1):
            for b in range(a):
                sums[kind, b, a] = sums[kind, a, b]
    return sums
