"""Set-up of a child process: signals, threads, memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from vaoi_station.runs.host.process_setup import keep_freed_memory

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


@pytest.mark.parametrize("before", [None, "glibc.malloc.check=0"])
def test_the_environment_is_restored(monkeypatch: pytest.MonkeyPatch, before: str | None) -> None:
    monkeypatch.delenv("GLIBC_TUNABLES", raising=False)
    if before is not None:
        monkeypatch.setenv("GLIBC_TUNABLES", before)
    with keep_freed_memory():
        assert os.environ["GLIBC_TUNABLES"].startswith(before or "glibc.malloc.hugetlb=1")
    assert os.environ.get("GLIBC_TUNABLES") == before


SETTINGS = """
import json, os, signal, sys
from vaoi_station.runs.host.process_setup import set_up_process

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
        "vaoi_station.runs.host.process_setup",
        "vaoi_station.runs.workers.forking.fork_server",
    ],
)
def test_a_child_process_starts_with_a_module_that_imports_little(module: str) -> None:
    # whatever this module imports, each child process imports, and most of it for nothing
    program = f"import sys, {module}; print(*{{'numba', 'numpy', 'pydantic'}} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, check=True)
    assert done.stdout == "\n"
