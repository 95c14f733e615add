from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats


def _sum_of_squares(values: Floats) -> float:
    total = 0.0
    for v in values:
        total += v * v
    return total


def test_compiled_code_says_what_the_source_says() -> None:
    values = np.random.default_rng(1).normal(size=1000)
    assert np.isclose(compiled(_sum_of_squares)(values), values @ values, rtol=1e-12)


def test_infinite_and_missing_values_keep_their_meaning() -> None:
    assert np.isnan(compiled(_sum_of_squares)(np.array([1.0, np.nan])))
    assert compiled(_sum_of_squares)(np.array([1.0, np.inf])) == np.inf


def test_a_function_whose_code_can_be_kept_nowhere_is_compiled_all_the_same() -> None:
    space: dict[str, Callable[[int], int]] = {}
    exec(compile("def twice(x):\n    return 2 * x\n", "<no file>", "exec"), space)  # noqa: S102
    twice = compiled(space["twice"])
    assert twice(21) == 42
