"""How far measurements scatter beyond their stated noise."""

from __future__ import annotations

import math

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.observations import Ints

_MEDIAN = 2 * math.log(2)
"""Median of χ² of two degrees of freedom."""
_HALVINGS = 12


@compiled
def noise_floor(residual: Floats, noise: Floats, per_unit: Floats, use: Ints, low: float, high: float) -> float:
    """Standard deviation that, added to the noise per axis, explains the median of residuals.

    Half of the measurements may be wild.

    Args:
        residual: (k, 2).
        noise: (k, 2, 2) covariances.
        per_unit: (k,) how much 1 of the answer's unit is in that of residual and noise, inverse: px per mm.
        use: numbers of those that count.
        low: the answer is at least that, in its own unit,
        high: and at most that.
    """
    left = use.copy()
    surely, undecided = 0, len(use)
    for _ in range(_HALVINGS):
        middle, above = math.sqrt(low * high), 0
        # those above the median's χ² are moved to the front; then one of the two parts is decided for good
        for at in range(undecided):
            n = left[at]
            x, y, more = residual[n, 0], residual[n, 1], (middle / per_unit[n]) ** 2
            a, b, d = noise[n, 0, 0] + more, noise[n, 0, 1], noise[n, 1, 1] + more
            if d * x * x - 2 * b * x * y + a * y * y > _MEDIAN * (a * d - b * b):
                left[at], left[above] = left[above], n
                above += 1
        if 2 * (surely + above) > len(use):
            low, undecided = middle, above
        else:
            high, surely = middle, surely + above
            left[: undecided - above] = left[above:undecided].copy()
            undecided -= above
    return math.sqrt(low * high)
