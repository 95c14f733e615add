"""The extents that a body may have in the footprint of its component.

How much of a footprint the body covers is not in the CAD data: leads, pads and bare board may surround it.
"""

from __future__ import annotations

import math

import numpy as np

from vaoi_station.geometry.transforms import Floats

_REACHES = (0.4, 0.52, 0.64, 0.76, 0.88, 1.0)
"""Possible distances from the centre of the footprint to an edge of the body, as shares of half the footprint.

Typical values: 0.42 for a SOT-23, 0.64 to 0.84 for integrated circuits with leads, 1 for a block that fills its
footprint."""
_REACH_PRIORS = (0.3, 0.6, 1.0, 1.0, 1.0, 1.5)  # relative prior probability of each of `_REACHES`


def _extents() -> Floats:
    number = range(len(_REACHES))
    table = [
        (_REACHES[i], _REACHES[j], math.sqrt(_REACH_PRIORS[i] * _REACH_PRIORS[j]) * (1.0 if i == j else 0.5))
        for i in number
        for j in number
        if abs(i - j) <= 1
    ]
    return np.array(table) / (1.0, 1.0, sum(prior for *_, prior in table))


EXTENTS = _extents()
"""Extents along one axis, (k, 3): reach below the centre, reach above it, prior probability.

The two reaches are equal, or differ by one step of `_REACHES`."""
