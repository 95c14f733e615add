"""CPU time and private memory of processes, compared with other sources of the same figures."""

from __future__ import annotations

import mmap
import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.benchmarks.process_usage import cpu_s, private_memory_bytes

TICK_S = 1 / os.sysconf("SC_CLK_TCK")
MIB = 2**20


@pytest.fixture
def odd_name() -> Iterator[None]:
    """Give this process a name with a space and parentheses."""
    comm = Path(f"/proc/{os.getpid()}/comm")
    before = comm.read_text()
    comm.write_text("a) R (b c")
    yield
    comm.write_text(before)


@pytest.mark.usefixtures("odd_name")
def test_cpu_time_is_that_of_the_interpreter_whatever_its_name() -> None:
    assert cpu_s(os.getpid()) == pytest.approx(time.process_time(), abs=3 * TICK_S)


def test_private_memory_counts_arrays_but_no_shared_mapping() -> None:
    before = private_memory_bytes()
    shared = mmap.mmap(-1, 32 * MIB, mmap.MAP_SHARED | mmap.MAP_ANONYMOUS)
    np.frombuffer(shared, np.uint8)[:: mmap.PAGESIZE] = 1
    with_shared = private_memory_bytes()
    array = np.ones(32 * MIB, np.uint8)
    with_array = private_memory_bytes(os.getpid())
    assert with_shared - before < 8 * MIB
    assert with_array - with_shared > 24 * MIB
    assert array[-1] == 1
