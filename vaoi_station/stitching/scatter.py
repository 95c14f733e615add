"""How far measurements scatter beyond their stated noise."""

from __future__ import annotations

import math

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats

_MEDIAN = 2 * math.log(2)
"""Median of χ² of two degrees of freedom."""
_HALVINGS = 12


@compiled
def excess(residual: Floats, noise: Floats, low: float, high: float) -> float:
    """Standard deviation that, added to noise (k, 2, 2) per axis, explains the median of residuals (k, 2).

    It lies between `low` and `high`, all in one unit. Half of the measurements may be wild.
    """
    for _ in range(_HALVINGS):
        middle, above = math.sqrt(low * high), 0
        for n in range(len(residual)):
            x, y = residual[n, 0], residual[n, 1]
            a, b, d = noise[n, 0, 0] + middle * middle, noise[n, 0, 1], noise[n, 1, 1] + middle * middle
            above += (d * x * x - 2 * b * x * y + a * y * y) / (a * d - b * b) > _MEDIAN
        if 2 * above > len(residual):
            low = middle
        else:
            high = middle
    return math.sqrt(low * high)
