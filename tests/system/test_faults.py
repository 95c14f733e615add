"""Real processes that die while a board passes: nothing that was filmed is lost."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path

from vaoi_station.config import StationConfig
from vaoi_station.model import Status
from vaoi_station.runs.conductor import StationConductor

PATIENCE_S = 120.0
RunStation = Callable[[StationConfig], StationConductor]


def wait_for_event(conductor: StationConductor, kind: str, state: str, after: int = 0) -> int:
    """Number of the next event of a kind."""
    while True:
        records = conductor.events(after, PATIENCE_S)
        assert records, conductor.snapshot()
        for record in records:
            if (record.kind, record.state) == (kind, state):
                return record.number
        after = records[-1].number


def pid_of(conductor: StationConductor, name: str) -> int:
    [pid] = [p.pid for p in conductor.snapshot().processes if p.name == name]
    assert pid is not None
    return pid


def test_a_worker_killed_while_a_board_passes(
    replay_config: Callable[..., StationConfig], run_station: RunStation
) -> None:
    conductor = run_station(replay_config(pace="original", pause_s=0.2))
    conductor.arm("small")
    wait_for_event(conductor, "run", "filming")
    os.kill(pid_of(conductor, "worker 0"), signal.SIGKILL)
    run = conductor.next_run(None, PATIENCE_S)
    assert run is not None
    assert (run.state, run.verdict, run.counts.missing) == ("ready", Status.OK, 0), run.reasons
    [restarts] = [p.restarts for p in conductor.snapshot().processes if p.name == "worker 0"]
    assert restarts == 1
    assert any("Worker 0 ended with code -9" in e.message for e in conductor.events() if e.kind == "process")


def test_the_acquisition_process_killed_while_a_board_passes(
    replay_config: Callable[..., StationConfig],
    run_station: RunStation,
    wait_state: Callable[[StationConductor, str], None],
) -> None:
    conductor = run_station(replay_config(pace="original", pause_s=0.2))
    conductor.arm("small", "b 1")
    began = wait_for_event(conductor, "run", "filming")
    victim = conductor.snapshot().filming
    assert victim is not None
    while conductor.run(victim).counts.ok < 4:
        conductor.events(conductor.snapshot().last_event, 0.02)
    os.kill(pid_of(conductor, "acquisition"), signal.SIGKILL)
    wait_for_event(conductor, "station", "faulted", began)
    first = conductor.next_run(None, 0.0) or conductor.latest() or conductor.next_run(None, PATIENCE_S)
    assert first is not None
    run = conductor.run(victim)
    assert run.state in ("degraded", "failed")
    assert run.counts.ok >= 4
    assert any(reason.code == "acquisition-lost" for reason in run.reasons)
    assert conductor.frame(victim, 0, 0)[0].any()
    wait_state(conductor, "armed")
    again = conductor.next_run(victim, PATIENCE_S)
    assert again is not None
    assert (again.board_id, again.verdict) == ("b 1", Status.OK)


def test_a_full_ring_loses_nothing_that_was_filmed(
    replay_config: Callable[..., StationConfig],
    run_station: RunStation,
    wait_state: Callable[[StationConductor, str], None],
) -> None:
    conductor = run_station(replay_config(pace="original", pause_s=0.5))
    conductor.arm("small")
    seen, runs = 0, []
    for _ in range(3):
        seen = wait_for_event(conductor, "run", "filming", seen)
        run = conductor.snapshot().filming or conductor.runs(1)[0].id
        conductor.hold(run, "tester", "AOI")
        runs.append(run)
    wait_state(conductor, "blocked")
    missed = conductor.snapshot().boards_missed
    after = conductor.snapshot().last_event
    while conductor.snapshot().boards_missed <= missed:
        records = conductor.events(after, PATIENCE_S)
        assert records
        after = records[-1].number
    assert all(conductor.frame(run, 0, 0)[0].any() for run in runs)
    conductor.let_go(runs[0], "tester")
    wait_state(conductor, "armed")
    assert conductor.next_run(runs[-1], PATIENCE_S) is not None


def test_nothing_is_left_behind(replay_config: Callable[..., StationConfig]) -> None:
    from vaoi_station.station import Station

    config = replay_config(pace="original", pause_s=0.1)
    with Station(config) as station:
        wait_for_event(station.conductor, "station", "idle")
        station.conductor.arm("small")
        wait_for_event(station.conductor, "run", "filming")
        pids = [p.pid for p in station.conductor.snapshot().processes]
    assert list(config.ring.directory.iterdir()) == []
    assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]
    station.stop()
