"""Estimate the noise floor of measurements: by how much they scatter beyond their stated noise."""

from __future__ import annotations

import math

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.observations import Ints

_MEDIAN = 2 * math.log(2)
"""Median of the χ² distribution with two degrees of freedom."""
_HALVINGS = 12
"""Number of bisections. With limits of 0.003 and 5 px, the result is uncertain by 0.2 %."""


@compiled
def noise_floor(residual: Floats, noise: Floats, per_unit: Floats, use: Ints, low: float, high: float) -> float:
    """Return the noise floor: the standard deviation per axis that must be added to the stated noise.

    With the noise floor, the median of the squared normalised residuals is that of χ² with two degrees of freedom. As a
    median is used, up to half of the measurements may be outliers.

    Args:
        residual: (k, 2) residuals.
        noise: (k, 2, 2) covariances of the stated noise.
        per_unit: (k,) units of the noise floor per unit of the residuals, for example px per mm.
        use: indices of the measurements that are used.
        low: lower limit of the noise floor.
        high: upper limit of the noise floor.
    """
    left = use.copy()
    surely, undecided = 0, len(use)
    for _ in range(_HALVINGS):
        # bisection in the logarithm: the limits are three orders of magnitude apart
        middle, above = math.sqrt(low * high), 0
        # Measurements above the median of χ² are moved to the front. The next bisection then tests only one of the two
        # parts, so that all bisections together take about as long as two passes over the measurements.
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
