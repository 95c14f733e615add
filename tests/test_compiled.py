"""Compiled functions compute what their source states, in all processes alike."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats


def _sum_of_squares(values: Floats) -> float:
    total = 0.0
    for v in values:
        total += v * v
    return total


def test_compiled_code_computes_what_the_source_states() -> None:
    values = np.random.default_rng(1).normal(size=1000)
    assert np.isclose(compiled(_sum_of_squares)(values), values @ values, rtol=1e-12)


def test_infinity_and_nan_keep_their_meaning() -> None:
    assert np.isnan(compiled(_sum_of_squares)(np.array([1.0, np.nan])))
    assert compiled(_sum_of_squares)(np.array([1.0, np.inf])) == np.inf


def test_a_function_without_a_file_is_compiled_without_a_cache() -> None:
    space: dict[str, Callable[[int], int]] = {}
    exec(compile("def twice(x):\n    return 2 * x\n", "<no file>", "exec"), space)  # noqa: S102  (a function that is in no file)
    twice = compiled(space["twice"])
    assert twice(21) == 42


_HALVES = """
import sys
from vaoi_station.compiled import compiled

@compiled
def half(x):
    return x / 2

@compiled
def quarter(x):
    return half(half(x))

sys.stdin.readline()
assert quarter(8.0) == 2.0
print(sum(quarter.stats.cache_misses.values()), flush=True)
"""


def test_processes_that_start_together_run_the_same_code(tmp_path: Path) -> None:
    source = tmp_path / "halves.py"
    source.write_text(_HALVES)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    twins = [
        subprocess.Popen(
            [sys.executable, source], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    for twin in twins:
        assert twin.stdin is not None
        twin.stdin.write("now\n")
        twin.stdin.flush()
    misses = [int(twin.communicate()[0]) for twin in twins]
    assert [twin.returncode for twin in twins] == [0, 0]
    assert sorted(misses) == [0, 1], "one compiles, the other finds the code"
