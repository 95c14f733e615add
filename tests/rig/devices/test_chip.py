"""The firmware on its emulated chip: clock, edges, resets, and its end."""

from __future__ import annotations

import os
import queue
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.rig.host import Host
from vaoi_station.acquisition.controller.protocol import Step
from vaoi_station.errors import DeviceError
from vaoi_station.rig import chip as chip_module
from vaoi_station.rig.chip import HZ, NS_PER_CYCLE, TRIGGER, Chip, Edge
from vaoi_station.simulation import Scenario

TIMEOUT_S = 20.0


@dataclass
class Bench:
    """A running chip and what it reports."""

    chip: Chip
    edges: queue.Queue[Edge]
    resets: queue.Queue[None]


@pytest.fixture
def bench(built: Path, tmp_path: Path) -> Iterator[Bench]:
    edges: queue.Queue[Edge] = queue.Queue()
    resets: queue.Queue[None] = queue.Queue()
    with Chip(built, tmp_path / "trigger", edges.put, lambda: resets.put(None)) as chip:
        yield Bench(chip, edges, resets)


def scripted(folder: Path, lines: str) -> Path:
    """A folder with a script in place of the emulator."""
    path = folder / "emulator"
    path.write_text(f"#!/bin/sh\n{lines}\n")
    path.chmod(0o755)
    return folder


def test_the_terminal_exists_while_the_chip_runs(built: Path, tmp_path: Path) -> None:
    terminal = tmp_path / "trigger"
    with Chip(built, terminal, lambda _: None) as chip:
        assert terminal.is_symlink()
        states = [chip.alive]
        assert chip.pid > 0
    states.append(chip.alive)
    assert states == [True, False]
    assert not terminal.exists()


def test_cycles_follow_the_clock_of_the_host(bench: Bench) -> None:
    now_ns = time.monotonic_ns()
    cycle = bench.chip.cycle_at(now_ns)
    assert abs(bench.chip.host_ns(cycle) - now_ns) <= NS_PER_CYCLE
    assert bench.chip.host_ns(cycle + HZ) - bench.chip.host_ns(cycle) == 1_000_000_000


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2**40))
def test_cycle_and_time_are_inverse(bench: Bench, cycle: int) -> None:
    assert bench.chip.cycle_at(bench.chip.host_ns(cycle)) == cycle


def test_a_board_in_the_barrier_fires_triggers_with_their_cycles(bench: Bench, small: Scenario) -> None:
    with Host(bench.chip.terminal) as host:
        host.arm(small, (Step(0b0001, 500),))
        blocked = bench.chip.cycle_at(time.monotonic_ns()) + HZ // 20
        bench.chip.send(f"at {blocked} PB0 1")
        host.wait(small.line.start_delay_s + 0.3)
    edges = [bench.edges.get_nowait() for _ in range(bench.edges.qsize())]
    first = next(edge for edge in edges if edge.pin == TRIGGER and edge.level)
    assert (first.cycle - blocked) / HZ == pytest.approx(small.line.start_delay_s, abs=1e-5)
    assert first.host_ns == bench.chip.host_ns(first.cycle)
    assert [edge.cycle for edge in edges] == sorted(edge.cycle for edge in edges)


def test_a_reset_is_reported(bench: Bench) -> None:
    while bench.resets.qsize():
        bench.resets.get()
    bench.chip.send("reset external")
    bench.resets.get(timeout=TIMEOUT_S)


def test_a_command_after_the_end_is_refused(bench: Bench) -> None:
    os.kill(bench.chip.pid, signal.SIGKILL)
    os.waitid(os.P_PID, bench.chip.pid, os.WEXITED | os.WNOWAIT)
    with pytest.raises(DeviceError, match="the emulated chip has ended"):
        bench.chip.send("pin PB0 1")
    assert not bench.chip.alive


def test_an_emulator_that_ends_at_once_is_refused(tmp_path: Path) -> None:
    with (
        pytest.raises(DeviceError, match="the emulated chip does not start"),
        Chip(scripted(tmp_path, "exit 1"), tmp_path / "trigger", lambda _: None),
    ):
        pass


def test_a_silent_emulator_is_refused_after_the_timeout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chip_module, "READY_TIMEOUT_S", 0.1)
    chip = Chip(scripted(tmp_path, "read line"), tmp_path / "trigger", lambda _: None)
    with pytest.raises(DeviceError, match="does not answer within"), chip:
        pass
    assert not chip.alive


def test_edges_are_dated_by_the_last_clock_line(tmp_path: Path) -> None:
    """A reset starts the clock again; edges before it keep their times."""
    lines = "echo clock 0 1000\necho edge 16 PB1 1\necho clock 100 9000\necho reset 100\necho edge 116 PB1 0\nread line"
    edges: queue.Queue[Edge] = queue.Queue()
    resets: queue.Queue[None] = queue.Queue()
    with Chip(scripted(tmp_path, lines), tmp_path / "trigger", edges.put, lambda: resets.put(None)):
        assert edges.get(timeout=TIMEOUT_S) == Edge(16, "PB1", True, 2000)
        assert edges.get(timeout=TIMEOUT_S) == Edge(116, "PB1", False, 10000)
        assert resets.qsize() == 1
