"""Workers that hang, jobs of closed runs, and limits: the pool goes on."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable
from typing import Any

import pytest

from tests.runs.workers.conftest import RingBoard
from tests.runs.workers.forking.served import few_files
from tests.runs.workers.plant import BoardPlant, Plant, conclusion
from vaoi_station.benchmarks.process_usage import cpu_s
from vaoi_station.drift.checks import RunCheck
from vaoi_station.errors import BusyError, StateError
from vaoi_station.runs.workers import pool as module
from vaoi_station.runs.workers.forking import fork_server_link
from vaoi_station.runs.workers.jobs import CheckJob
from vaoi_station.runs.workers.queues import MAX_PICTURES


def test_the_job_of_a_worker_that_hangs_is_repeated_at_once(plant: Plant) -> None:
    plant.all_idle()
    victim = plant.pid(0)
    os.kill(victim, signal.SIGSTOP)
    try:
        pending = [plant.submit(plant.link(0, row)) for row in (0, 1, 0)]
        assert all(p.get().error is None for p in pending)
        assert plant.lost == [], "no worker had to be killed for it"
    finally:
        os.kill(victim, signal.SIGCONT)
    plant.all_idle()
    assert all(len(p.answers) == 1 for p in pending), "the late replies of the worker that hung are dropped"
    assert plant.submit(plant.link()).get().error is None


def test_a_worker_that_another_has_outrun_is_replaced_soon(plant: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REPEATED_LIMIT_S", 1.5)
    plant.all_idle()
    victim = plant.pid(0)
    os.kill(victim, signal.SIGSTOP)
    assert plant.submit(plant.link()).get().error is None
    plant.until(lambda: len(plant.lost) == 1)
    assert "Worker 0 did not answer for 1.5 s" in plant.lost[0]
    plant.all_idle()
    assert plant.pid(0) != victim


def test_a_conclusion_does_not_wait_for_a_worker_that_hangs(board_plant: BoardPlant, ring_board: RingBoard) -> None:
    linked = board_plant.linked([ring_board.link(task) for task in ring_board.tasks])
    board_plant.all_idle()
    victim = board_plant.pid(1)
    os.kill(victim, signal.SIGSTOP)
    try:
        check = CheckJob("r1", "2026-01-01T00:00:00Z", "board-type", "calibration")
        checked = board_plant.expect(check)
        result = board_plant.submit(ring_board.conclusion(linked, check))
        assert result.get().error is None
        assert isinstance(checked.get().value, RunCheck)
    finally:
        with contextlib.suppress(ProcessLookupError):  # a worker that was outrun is killed after some seconds
            os.kill(victim, signal.SIGCONT)
    board_plant.all_idle()
    assert [len(p.answers) for p in (result, checked)] == [1, 1], "result and check of the slower worker are dropped"


def test_a_conclusion_of_a_closed_run_is_not_repeated(plant: Plant, make_head: Any) -> None:
    """Its worker dies after the run was closed: the pool goes on."""
    plant.all_idle()
    for worker in (0, 1):
        os.kill(plant.pid(worker), signal.SIGSTOP)
    plant.submit(conclusion(plant, make_head(3), [], []))
    plant.pool.close_run("r1")
    for worker in (0, 1):
        os.kill(plant.pid(worker), signal.SIGKILL)
    plant.until(lambda: len(plant.lost) == 2)
    refused = plant.submit(plant.link()).get()
    assert isinstance(refused.error, StateError)
    assert "after the run was closed" in refused.error.message
    plant.open_run()
    assert plant.submit(plant.link()).get().error is None
    assert plant.pool.thread.fault() is None


def test_waiting_pictures_are_limited(plant: Plant, make_stitch: Callable[..., Any], make_head: Any) -> None:
    plant.all_idle()
    for worker in (0, 1):
        os.kill(plant.pid(worker), signal.SIGSTOP)
    try:
        pending = [plant.submit(plant.picture(make_stitch, make_head(3))) for _ in range(MAX_PICTURES + 1)]
        refused = plant.submit(plant.picture(make_stitch, make_head(3))).get()
    finally:
        for worker in (0, 1):
            os.kill(plant.pid(worker), signal.SIGCONT)
    assert isinstance(refused.error, BusyError)
    assert refused.error.code == "pictures-busy"
    assert all(p.get().error is None for p in pending)


def test_a_worker_that_cannot_be_started_is_tried_again(plant: Plant) -> None:
    plant.all_idle()
    server = plant.pool.fork_server.status().pid
    assert server is not None
    with few_files(server, 0):
        os.kill(plant.pid(0), signal.SIGKILL)
        plant.until(lambda: len(plant.lost) == 2)
        assert "Worker 0 could not be started (the fork server has too many open files)" in plant.lost[1]
    plant.all_idle()
    assert plant.submit(plant.link()).get().error is None


def test_a_killed_worker_has_a_successor_that_imports_nothing(plant: Plant) -> None:
    plant.all_idle()
    os.kill(plant.pid(0), signal.SIGKILL)
    plant.until(lambda: len(plant.lost) == 1)
    plant.all_idle()
    assert cpu_s(plant.pid(0)) < 0.3, "a start by itself takes seconds"


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_workers_go_on_without_the_fork_server(
    plant: Plant, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    """A worker that dies meanwhile is replaced by the next fork server; its exit code remains unknown."""
    plant.all_idle()
    server, workers = plant.pool.fork_server.status().pid, [plant.pid(0), plant.pid(1)]
    assert server is not None
    os.kill(server, number)
    os.kill(workers[0], signal.SIGKILL)
    pending = [plant.submit(plant.link(camera, row)) for row in range(2) for camera in (0, 1)]
    assert all(p.get().error is None for p in pending)
    with monkeypatch.context() as impatient:  # only now: the next server may start slowly
        impatient.setattr(fork_server_link, "REPLY_LIMIT_S", 1.0)
        plant.until(lambda: any("The fork server" in words for words in plant.lost))
    plant.all_idle()
    how = "ended with code -9" if number == signal.SIGKILL else "did not answer for 1 s, so that the station ended it"
    assert f"The fork server {how}; it is restarted. Workers that run go on." in plant.lost
    assert plant.pid(0) != workers[0]
    assert plant.pid(1) == workers[1]
    assert plant.pool.fork_server.status().pid != server
    assert plant.submit(plant.link()).get().error is None
    assert plant.pool.thread.fault() is None
