"""Names, signals, memory and garbage collections of processes."""

from __future__ import annotations

import gc
import json
import multiprocessing
import os
import subprocess
import sys
import weakref
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path
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


def test_the_interpreter_runs_no_full_collection(policy: GcPolicy) -> None:
    collections = gc.get_stats()[2]["collections"]
    kept = [[k] for k in range(400_000)]
    assert gc.get_stats()[2]["collections"] == collections
    assert len(kept) == 400_000


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


SETTINGS = """
import json, os, signal, sys
from vaoi_station.runs.host.processes import set_up_process

set_up_process(one_thread=sys.argv[1] == "1")
ignored = [signal.getsignal(n) is signal.SIG_IGN for n in (signal.SIGINT, signal.SIGTERM)]
print(json.dumps([ignored, os.environ.get("OMP_NUM_THREADS")]))
"""


@pytest.mark.parametrize(("one_thread", "threads"), [(True, "1"), (False, "7")])
def test_a_child_ignores_signals_and_may_be_limited_to_one_thread(one_thread: bool, threads: str) -> None:
    command = [sys.executable, "-c", SETTINGS, str(int(one_thread))]
    environment = {**os.environ, "OMP_NUM_THREADS": "7"}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    assert json.loads(done.stdout.splitlines()[-1]) == [[True, True], threads]


@pytest.mark.parametrize(
    "module",
    [
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


def test_a_child_process_shows_its_name_instead_of_how_it_was_started() -> None:
    spawn = multiprocessing.get_context("spawn")
    here, there = spawn.Pipe()
    process = spawn.Process(target=child, args=(there,), name="vaoi-worker-1", daemon=True)
    process.start()
    place = Path(f"/proc/{here.recv()}")
    command, comm = (place / "cmdline").read_bytes(), (place / "comm").read_text()
    here.send(None)
    process.join(10)
    assert command.rstrip(b"\0") == b"vaoi-worker-1"
    assert comm == "vaoi-worker-1\n"
    assert process.exitcode == 0
