"""How a process of the station begins."""

from __future__ import annotations

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
    # numpy asks for large pages by itself; then a fault is two megabytes, and there are few either way
    environment = {**os.environ, "NUMPY_MADVISE_HUGEPAGE": "0"}
    done = subprocess.run(
        [sys.executable, "-c", FAULTS], env=environment, stdout=subprocess.PIPE, text=True, check=True
    )
    return int(done.stdout)


def test_memory_that_was_given_back_is_not_had_anew() -> None:
    as_it_is = faults()
    with keep_freed_memory():
        kept = faults()
    assert kept < 100 < as_it_is


@pytest.mark.parametrize("before", [None, "glibc.malloc.check=0"])
def test_the_environment_is_put_back(monkeypatch: pytest.MonkeyPatch, before: str | None) -> None:
    monkeypatch.delenv("GLIBC_TUNABLES", raising=False)
    if before is not None:
        monkeypatch.setenv("GLIBC_TUNABLES", before)
    with keep_freed_memory():
        assert os.environ["GLIBC_TUNABLES"].startswith(before or "glibc.malloc.hugetlb=1")
    assert os.environ.get("GLIBC_TUNABLES") == before
