"""Names, signals, memory and garbage collections of processes."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import weakref
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

import pytest

from vaoi_station.runs.host.processes import (
    IDLE_S,
    GcPolicy,
    keep_freed_memory,
    set_up_process,
)


class Knot:
    """An object that refers to itself, so that only the collector frees it."""

    def __init__(self) -> None:
        self.itself = self


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def policy(clock: Clock) -> Iterator[GcPolicy]:
    policy = GcPolicy(clock)
    policy.start()
    yield policy
    policy.stop()


def old_knot() -> weakref.ref[Knot]:
    """Garbage of the oldest generation, which only a full collection finds."""
    knot = Knot()
    gc.collect(1)
    gc.collect(1)
    return weakref.ref(knot)


def test_a_full_collection_waits_until_no_board_is_processed(policy: GcPolicy, clock: Clock) -> None:
    knot = old_knot()
    clock.now_s += IDLE_S
    policy.tick(busy=True)
    assert knot() is not None
    policy.tick(busy=False)
    assert knot() is None


FAULTS = """
import resource
import numpy as np

for _ in range(4):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    arrays = [np.ones(1 << 17) for _ in range(32)]
    del arrays
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults() -> int:
    # numpy requests large pages itself; a fault then covers 2 MB, and there are few in either case
    environment = {**os.environ, "NUMPY_MADVISE_HUGEPAGE": "0"}
    done = subprocess.run(
        [sys.executable, "-c", FAULTS], env=environment, stdout=subprocess.PIPE, text=True, check=True
    )
    return int(done.stdout)


def test_freed_memory_is_used_again_without_page_faults() -> None:
    as_it_is = faults()
    with keep_freed_memory():
        kept = faults()
    assert kept < 100 < as_it_is


@pytest.mark.parametrize(
    "module",
    [
        "vaoi_station.demo.service",
        "vaoi_station.demo.service_process",
        "vaoi_station.runs.host.processes",
        "vaoi_station.runs.workers.fork_server",
    ],
)
def test_a_child_process_starts_with_a_module_that_imports_little(module: str) -> None:
    # whatever this module imports, each child process imports, and most of it for nothing
    program = f"import sys, {module}; print(*{{'numba', 'numpy', 'pydantic'}} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, check=True)
    assert done.stdout == "\n"


def child(connection: Connection[Any, Any]) -> None:
    set_up_process(one_thread=False)
    connection.send(os.getpid())
    connection.recv()
