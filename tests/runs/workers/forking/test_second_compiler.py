"""Two processes compile at the first start: the second one is started when it is needed, and ends with the first."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from vaoi_station.runs.workers.forking.second_compiler import ORPHANED

SAME_CODE = """
from vaoi_station import compiled
from vaoi_station.runs.workers import worker_runtime
from vaoi_station.runs.workers.warmup import warm_up, warm_up_from_the_end

warm_up_from_the_end()
second = compiled.signatures()
warm_up()
first = compiled.signatures()
warm_up_from_the_end()
print(len(second), len(first), *(compiled.signatures() - first))
"""
"""Prints how many functions the second process compiles, how many the first needs, and what is compiled in vain."""

STARTED = """
import os
from pathlib import Path
from vaoi_station.compiled import compiled
from vaoi_station.runs.workers.forking.second_compiler import second_compiler

def children():
    return len(Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())

@compiled
def half(x):
    return x / 2

os.sched_getaffinity = lambda pid: set(range(CORES))
with second_compiler():
    before = children()
    assert half(2.0) == 1.0
    meanwhile = children()
    assert half(2) == 1.0
    again = children()
print(before, meanwhile, again, children())
"""
"""Prints the number of child processes before, while and after this process compiles, and after the context."""


def test_the_second_process_compiles_what_the_first_one_needs_and_nothing_else() -> None:
    done = subprocess.run([sys.executable, "-c", SAME_CODE], check=True, capture_output=True, text=True)
    second, first, *in_vain = done.stdout.split()
    assert in_vain == []
    assert int(first) / 4 < int(second) < int(first)


def started(folder: Path, cores: int) -> str:
    source = folder / "started.py"
    source.write_text(STARTED.replace("CORES", str(cores)))
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")}
    return subprocess.run(
        [sys.executable, source], env=environment, check=True, capture_output=True, text=True
    ).stdout.strip()


def test_the_second_process_is_started_when_the_first_one_compiles_and_ends_with_the_context(tmp_path: Path) -> None:
    assert started(tmp_path, cores=2) == "0 1 1 0"
    assert started(tmp_path, cores=2) == "0 0 0 0", "all machine code is in the cache"


def test_a_process_with_one_core_compiles_alone(tmp_path: Path) -> None:
    assert started(tmp_path, cores=1) == "0 0 0 0"


def test_the_second_process_ends_with_the_first(tmp_path: Path) -> None:
    """With an empty cache it would compile for longer than this test takes."""
    process = subprocess.Popen(
        [sys.executable, "-m", "vaoi_station.runs.workers.forking.second_compiler"],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        stdin=subprocess.PIPE,
    )
    process.communicate()
    assert process.returncode == ORPHANED
