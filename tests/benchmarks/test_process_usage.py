"""CPU time and private memory of processes, compared with other sources of the same figures."""

from __future__ import annotations

import mmap
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.benchmarks.process_usage import CpuMeter, ThreadMeter, cpu_s, private_memory_bytes

TICK_S = 1 / os.sysconf("SC_CLK_TCK")
MIB = 2**20


def burn(cpu_s: float) -> None:
    end = time.process_time() + cpu_s
    while time.process_time() < end:
        pass


@pytest.fixture
def odd_name() -> Iterator[None]:
    """Give this process a name with a space and parentheses."""
    comm = Path(f"/proc/{os.getpid()}/comm")
    before = comm.read_text()
    comm.write_text("a) R (b c")
    yield
    comm.write_text(before)


def test_cpu_time_is_that_of_the_interpreter() -> None:
    assert cpu_s(os.getpid()) == pytest.approx(time.process_time(), abs=3 * TICK_S)


@pytest.mark.usefixtures("odd_name")
def test_parentheses_in_the_name_do_not_shift_the_fields() -> None:
    assert cpu_s(os.getpid()) == pytest.approx(time.process_time(), abs=3 * TICK_S)


def test_meter_counts_from_its_creation_and_with_all_threads() -> None:
    meter = CpuMeter({"me": os.getpid(), "parent": os.getppid()})
    thread = threading.Thread(target=burn, args=(0.08,))
    thread.start()
    thread.join()
    used = meter.read()
    assert used.keys() == {"me", "parent"}
    assert 0.08 - 2 * TICK_S <= used["me"] < 1


def test_threads_are_measured_by_name_from_the_creation_of_their_meter() -> None:
    go_on, burnt, end = threading.Event(), threading.Event(), threading.Event()

    def work() -> None:
        burn(0.05)
        burnt.set()
        assert go_on.wait(60)
        burn(0.05)
        burnt.set()
        assert end.wait(60)

    threads = [threading.Thread(target=work, name="measured"), threading.Thread(target=end.wait, name="other")]
    for thread in threads:
        thread.start()
    assert burnt.wait(60)
    burnt.clear()
    meter = ThreadMeter(["measured"])
    go_on.set()
    assert burnt.wait(60)
    assert 0.04 < meter.read() < 0.09
    end.set()
    for thread in threads:
        thread.join()


def test_unknown_process_has_no_figures() -> None:
    with pytest.raises(OSError, match="/proc/0"):
        cpu_s(0)


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
