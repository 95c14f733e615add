"""Compiled weights of the tiles of a body: tiles whose height differs from that of most others have less."""

from __future__ import annotations

import math

import numpy as np

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.small_sorts import ascending
from vaoi_station.geometry.transforms import Floats

_INFORMED = 0.1
"""Least share of the squared gradients that is texture; with less, it is noise."""
_TIGHT = 4.0
"""Tiles whose height differs by more than this many standard deviations are left out."""
_UNEVEN_MM = 0.02
"""Standard deviation of the heights of places on a body, beside noise."""
_ROUNDS = 4


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
    for _ in range(_ROUNDS):
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
