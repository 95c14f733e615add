from __future__ import annotations

import numpy as np

from vaoi_station.compiled import compiled
from vaoi_station.geometry.small_sorts import ascending
from vaoi_station.geometry.transforms import Floats


@compiled
def _order(values: Floats) -> np.ndarray:
    return ascending(values)


def test_values_are_ordered_and_equal_ones_keep_their_order() -> None:
    g = np.random.default_rng(1)
    for n in (0, 1, 2, 7, 40):
        values = g.integers(0, 9, n).astype(np.float64)
        assert _order(values).tolist() == np.argsort(values, kind="stable").tolist()
