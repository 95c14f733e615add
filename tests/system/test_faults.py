"""Processes that are killed while a board passes: no frame that was taken is lost."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path

from vaoi_station.config import StationConfig
from vaoi_station.model import Status
from vaoi_station.runs.control.coordinator import StationCoordinator

TIMEOUT_S = 120.0
RunStation = Callable[[StationConfig], StationCoordinator]


def wait_for_event(coordinator: StationCoordinator, kind: str, state: str, after: int = 0) -> int:
    """Wait for the next event of a kind; return its number."""
    while True:
        records = coordinator.events(after, TIMEOUT_S)
        assert records, coordinator.snapshot()
        for record in records:
            if (record.kind, record.state) == (kind, state):
                return record.number
        after = records[-1].number


def pid_of(coordinator: StationCoordinator, name: str) -> int:
    [pid] = [p.pid for p in coordinator.snapshot().processes if p.name == name]
    assert pid is not None
    return pid


def test_a_worker_killed_while_a_board_passes(
    replay_config: Callable[..., StationConfig], run_station: RunStation
) -> None:
    coordinator = run_station(replay_config(pace="original", pause_s=0.2))
    coordinator.arm("small")
    wait_for_event(coordinator, "run", "filming")
    os.kill(pid_of(coordinator, "worker 0"), signal.SIGKILL)
    run = coordinator.next_run(None, TIMEOUT_S)
    assert run is not None
    assert (run.state, run.verdict, run.counts.missing) == ("ready", Status.OK, 0), run.reasons
    [restarts] = [p.restarts for p in coordinator.snapshot().processes if p.name == "worker 0"]
    assert restarts == 1
    assert any("Worker 0 ended with code -9" in e.message for e in coordinator.events() if e.kind == "process")


def test_the_acquisition_process_killed_while_a_board_passes(
    replay_config: Callable[..., StationConfig],
    run_station: RunStation,
    wait_state: Callable[[StationCoordinator, str], None],
) -> None:
    coordinator = run_station(replay_config(pace="original", pause_s=0.2))
    coordinator.arm("small", "b 1")
    began = wait_for_event(coordinator, "run", "filming")
    victim = coordinator.snapshot().filming
    assert victim is not None
    while coordinator.run(victim).counts.ok < 4:
        coordinator.events(coordinator.snapshot().last_event, 0.02)
    os.kill(pid_of(coordinator, "acquisition"), signal.SIGKILL)
    wait_for_event(coordinator, "station", "faulted", began)
    first = coordinator.next_run(None, 0.0) or coordinator.latest() or coordinator.next_run(None, TIMEOUT_S)
    assert first is not None
    run = coordinator.run(victim)
    assert run.state in ("degraded", "failed")
    assert run.counts.ok >= 4
    assert any(reason.code == "acquisition-lost" for reason in run.reasons)
    assert coordinator.frame(victim, 0, 0)[0].any()
    wait_state(coordinator, "armed")
    again = coordinator.next_run(victim, TIMEOUT_S)
    assert again is not None
    assert (again.board_id, again.verdict) == ("b 1", Status.OK)


def test_full_ring_loses_no_frame_that_was_taken(
    replay_config: Callable[..., StationConfig],
    run_station: RunStation,
    wait_state: Callable[[StationCoordinator, str], None],
) -> None:
    coordinator = run_station(replay_config(pace="original", pause_s=0.5))
    coordinator.arm("small")
    seen, runs = 0, []
    for _ in range(3):
        seen = wait_for_event(coordinator, "run", "filming", seen)
        run = coordinator.snapshot().filming or coordinator.runs(1)[0].id
        coordinator.hold(run, "tester", "AOI")
        runs.append(run)
    wait_state(coordinator, "blocked")
    missed = coordinator.snapshot().boards_missed
    after = coordinator.snapshot().last_event
    while coordinator.snapshot().boards_missed <= missed:
        records = coordinator.events(after, TIMEOUT_S)
        assert records
        after = records[-1].number
    assert all(coordinator.frame(run, 0, 0)[0].any() for run in runs)
    coordinator.end_hold(runs[0], "tester")
    wait_state(coordinator, "armed")
    assert coordinator.next_run(runs[-1], TIMEOUT_S) is not None


def test_no_process_or_ring_remains_after_the_stop(replay_config: Callable[..., StationConfig]) -> None:
    from vaoi_station.station import Station

    config = replay_config(pace="original", pause_s=0.1)
    with Station(config) as station:
        wait_for_event(station.coordinator, "station", "idle")
        station.coordinator.arm("small")
        wait_for_event(station.coordinator, "run", "filming")
        pids = [p.pid for p in station.coordinator.snapshot().processes]
    assert list(config.ring.directory.iterdir()) == []
    assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]
    station.stop()
