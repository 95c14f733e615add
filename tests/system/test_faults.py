"""Processes that are killed while a board passes: no frame that was taken is lost."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.system.conftest import config_of, until_state
from vaoi_station.config import ReplayConfig, StationConfig
from vaoi_station.model import Status
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.simulation import Twin
from vaoi_station.station import Station

TIMEOUT_S = 120.0


@pytest.fixture(scope="module")
def station(
    twin: Twin, recordings: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[StationCoordinator]:
    """A station that replays boards at the recorded pace without end."""
    replay = ReplayConfig(recordings=recordings, pace="original", pause_s=0.3)
    with Station(config_of(twin, tmp_path_factory.mktemp("faults"), "replay", replay=replay)) as started:
        yield started.coordinator


@pytest.fixture
def coordinator(station: StationCoordinator) -> Iterator[StationCoordinator]:
    """The station, idle before and after each test."""
    until_state(station, "idle")
    yield station
    station.disarm()
    until_state(station, "idle")


def wait_for_event(coordinator: StationCoordinator, kind: str, state: str, after: int = 0) -> int:
    """Wait for the next event of a kind; return its number."""
    while True:
        records = coordinator.events(after, TIMEOUT_S)
        assert records, coordinator.snapshot()
        for record in records:
            if (record.kind, record.state) == (kind, state):
                return record.number
        after = records[-1].number


def arm_until_filming(coordinator: StationCoordinator, board_id: str | None = None) -> tuple[int, str]:
    """Arm; return the number of the event of the first board that passes, and its run."""
    seen = coordinator.snapshot().last_event
    coordinator.arm("small", board_id)
    return next_filming(coordinator, seen)


def next_filming(coordinator: StationCoordinator, seen: int) -> tuple[int, str]:
    number = wait_for_event(coordinator, "run", "filming", seen)
    [run] = [record.run for record in coordinator.events(number - 1) if record.number == number]
    assert run is not None
    return number, run


def result_of(coordinator: StationCoordinator, run: str, after: int) -> RunDetail:
    """Wait until a run has ended."""
    while coordinator.run(run).state not in ("ready", "degraded", "failed"):
        records = coordinator.events(after, TIMEOUT_S)
        assert records, coordinator.snapshot()
        after = records[-1].number
    return coordinator.run(run)


def pid_of(coordinator: StationCoordinator, name: str) -> int:
    [pid] = [p.pid for p in coordinator.snapshot().processes if p.name == name]
    assert pid is not None
    return pid


def test_a_worker_killed_while_a_board_passes(coordinator: StationCoordinator) -> None:
    began, victim = arm_until_filming(coordinator)
    os.kill(pid_of(coordinator, "worker 0"), signal.SIGKILL)
    run = result_of(coordinator, victim, began)
    assert (run.state, run.verdict, run.counts.missing) == ("ready", Status.OK, 0), run.reasons
    [restarts] = [p.restarts for p in coordinator.snapshot().processes if p.name == "worker 0"]
    assert restarts == 1
    assert any("Worker 0 ended with code -9" in e.message for e in coordinator.events() if e.kind == "process")


def test_the_acquisition_process_killed_while_a_board_passes(coordinator: StationCoordinator) -> None:
    began, victim = arm_until_filming(coordinator, "b 1")
    while coordinator.run(victim).counts.ok < 4:
        coordinator.events(coordinator.snapshot().last_event, 0.02)
    os.kill(pid_of(coordinator, "acquisition"), signal.SIGKILL)
    wait_for_event(coordinator, "station", "faulted", began)
    run = result_of(coordinator, victim, began)
    assert run.state in ("degraded", "failed")
    assert run.counts.ok >= 4
    assert any(reason.code == "acquisition-lost" for reason in run.reasons)
    assert coordinator.frame(victim, 0, 0)[0].any()
    until_state(coordinator, "armed")
    again = coordinator.next_run(victim, TIMEOUT_S)
    assert again is not None
    assert (again.board_id, again.verdict) == (None, Status.DEGRADED), "boards may have passed unnoticed meanwhile"
    assert [reason.code for reason in again.reasons] == ["board-id-uncertain"]


def test_a_full_memory_holds_boards_back_and_none_is_missed(
    twin_config: StationConfig,
    run_station: Callable[[StationConfig], StationCoordinator],
    wait_state: Callable[[StationCoordinator, str], None],
) -> None:
    """Without the interlock a board is missed here, as above."""
    controller = twin_config.controller.model_copy(update={"interlock": "on"})
    coordinator = run_station(twin_config.model_copy(update={"controller": controller}))
    coordinator.arm("small")
    last: str | None = None
    runs: list[str] = []
    while len(runs) < 3:
        found = coordinator.next_run(last, TIMEOUT_S)
        assert found is not None
        last = found.id
        coordinator.hold(last, "tester", "AOI")
        runs.append(last)
    wait_state(coordinator, "blocked")
    snapshot = coordinator.snapshot()
    assert [reason.code for reason in snapshot.line_held] == ["ring-full"]
    # A board every 0.5 s, so more than one would have come by now.
    assert coordinator.next_run(last, 1.5) is None
    assert coordinator.snapshot().boards_missed == 0
    coordinator.end_hold(runs[0], "tester")
    following = coordinator.next_run(last, TIMEOUT_S)
    assert following is not None
    assert coordinator.snapshot().boards_missed == 0


def test_no_process_or_ring_remains_after_the_stop(replay_config: Callable[..., StationConfig]) -> None:
    config = replay_config(pace="original", pause_s=0.1)
    with Station(config) as station:
        wait_for_event(station.coordinator, "station", "idle")
        station.coordinator.arm("small")
        wait_for_event(station.coordinator, "run", "filming")
        pids = [p.pid for p in station.coordinator.snapshot().processes]
    assert list(config.ring.directory.iterdir()) == []
    assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]
    station.stop()
