"""CPU time and private memory of processes, compared with other sources of the same figures."""

from __future__ import annotations

import mmap
import os

import numpy as np

from vaoi_station.benchmarks.process_usage import private_memory_bytes

MIB = 2**20


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
