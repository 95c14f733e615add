"""Compiled functions compute what their source states; processes share the compiled code."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
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


def test_a_process_that_calls_no_compiled_function_does_not_load_numba() -> None:
    """The station process and the acquisition process call none: Numba takes a second and 60 MB."""
    program = "import sys, vaoi_station.station, vaoi_station.acquisition.simulated; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, check=True)
    assert done.stdout == "False\n"


def test_a_function_without_a_file_is_compiled_without_a_cache() -> None:
    space: dict[str, Callable[[int], int]] = {}
    exec(compile("def twice(x):\n    return 2 * x\n", "<no file>", "exec"), space)  # noqa: S102  (a function that is in no file)
    twice = compiled(space["twice"])
    assert twice(21) == 42


_SHARED = """
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
    source = tmp_path / "shared.py"
    source.write_text(_SHARED)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    processes = [
        subprocess.Popen(
            [sys.executable, source], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    for process in processes:
        assert process.stdin is not None
        process.stdin.write("now\n")
        process.stdin.flush()
    misses = [int(process.communicate()[0]) for process in processes]
    assert [process.returncode for process in processes] == [0, 0]
    assert sorted(misses) == [0, 1], "one compiles, the other finds the code"
    locks = [*(tmp_path / "cache").rglob("*.lock")]
    assert sorted(lock.name for lock in locks) == ["__main__.half.lock", "__main__.quarter.lock"]
    with ExitStack() as loading:  # as a process does that loads code from the cache
        for lock in locks:
            fcntl.flock(loading.enter_context(lock.open("w")), fcntl.LOCK_SH)
        third = [sys.executable, str(source)]
        done = subprocess.run(third, env=environment, input="now\n", capture_output=True, text=True, check=True)
    assert int(done.stdout) == 0


_NAMED = """
from typing import NamedTuple
import numpy as np
from vaoi_station.compiled import compiled, inlined

class Points(NamedTuple):
    x: np.ndarray
    y: np.ndarray

@inlined
def product(points, n):
    return points.x[n] * points.y[n]

@compiled
def swap(points):
    total = 0.0
    for n in range(len(points.x)):
        total += product(points, n)
        points.x[n], points.y[n] = points.y[n], points.x[n]
    return Points(points.y, points.x), total
"""

_USE_NAMED = """
import numpy as np
from named import Points, swap

points = Points(np.arange(3.0), np.full(3, 2.0))
swapped, total = swap(points)
assert total == 6.0
assert points.x.tolist() == [2.0, 2.0, 2.0]
assert swapped.x.tolist() == [0.0, 1.0, 2.0]
print(sum(swap.stats.cache_misses.values()))
"""


def test_named_tuples_are_passed_without_a_copy_and_their_code_is_cached(tmp_path: Path) -> None:
    """The class lies in a module that is imported, as in the package: one of `__main__` differs in every process."""
    (tmp_path / "named.py").write_text(_NAMED)
    paths = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": paths}
    runs = [
        subprocess.run([sys.executable, "-c", _USE_NAMED], env=environment, capture_output=True, text=True, check=True)
        for _ in range(2)
    ]
    assert [int(run.stdout) for run in runs] == [1, 0], "the second process finds the code of the first"


_HELPER = """
from vaoi_station.compiled import inlined
FACTOR = {factor}

@inlined
def scaled(x):
    return FACTOR * x + {term}
"""

_CALLER = """
from helper import scaled
from vaoi_station.compiled import compiled

@compiled
def twice(x):
    return scaled(scaled(x))
"""


def test_code_is_renewed_with_what_it_calls_and_with_constants_and_by_nothing_else(tmp_path: Path) -> None:
    """Numba's own cache looks at one file: a helper that had changed in another one went on as it was."""
    paths = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": paths}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"
    program = "from caller import twice; print(twice(1.0), sum(twice.stats.cache_misses.values()))"

    def run(factor: float, term: float, before: str = "") -> str:
        (tmp_path / "helper.py").write_text(before + _HELPER.format(factor=factor, term=term))
        (tmp_path / "caller.py").write_text(before + _CALLER)
        command = [sys.executable, "-c", program]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.strip()

    assert run(2.0, 0.5) == "5.5 1"
    assert run(2.0, 0.5, before="# other lines\nOTHER = 1\n") == "5.5 0"
    assert run(3.0, 0.5) == "11.0 1"
    assert run(2.0, 0.5) == "5.5 0", "another version of the program, as that before an update, finds its own code"
    for file in (tmp_path / "cache").glob("*.nbc"):
        os.utime(file, (0, 0))
    assert run(3.0, 0.5) == "11.0 0"
    assert run(3.0, 1.0) == "13.0 1"
    assert run(2.0, 0.5) == "5.5 1", "code that was not used for long is gone; what was loaded lately stays"
    for file in (tmp_path / "cache").glob("*.nbc"):
        os.truncate(file, file.stat().st_size // 2)
    assert run(3.0, 0.5) == "11.0 1", "a power cut has left a part of it"


_AFTER_A_LOSS = """
import shutil
from pathlib import Path
from vaoi_station.compiled import cache_directory, compiled

@compiled
def half(x):
    return x / 2

@compiled
def third(x):
    return x / 3

@compiled
def fourth(x):
    return x / 4

directory = cache_directory()
assert half(2.0) == 1.0
shutil.rmtree(directory)
assert third(3.0) == 1.0
assert [*directory.glob("*.nbc")], "what was emptied is filled again"
shutil.rmtree(directory)
directory.write_text("as little can be written here as on a full disk")
assert fourth(4.0) == 1.0
"""


def test_a_cache_that_is_lost_while_a_process_runs_costs_only_time(tmp_path: Path) -> None:
    source = tmp_path / "lost.py"
    source.write_text(_AFTER_A_LOSS)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    done = subprocess.run([sys.executable, source], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
