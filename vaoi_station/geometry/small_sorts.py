"""Sorting of a few numbers in compiled functions by insertion: numpy's sorts take a second each to compile."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import inlined
from vaoi_station.geometry.transforms import Floats


@inlined
def ascending(values: Floats) -> NDArray[np.int_]:
    """Return the numbers (n,) of the values in ascending order of the values. Only compiled functions call it."""
    order = np.empty(len(values), np.int64)
    for n in range(len(values)):
        at = n
        while at > 0 and values[order[at - 1]] > values[n]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = n
    return order
