"""Workers that hang, jobs of closed runs, and limits: the pool goes on."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable
from typing import Any

import pytest

from tests.runs.workers.conftest import RingBoard
from tests.runs.workers.plant import BoardPlant, Plant, conclusion
from vaoi_station.drift.checks import RunCheck
from vaoi_station.errors import BusyError, StateError
from vaoi_station.runs.workers import pool as module
from vaoi_station.runs.workers.jobs import CheckJob
from vaoi_station.runs.workers.queues import MAX_PICTURES
from vaoi_station.runs.workers.worker import start_process


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


def test_a_worker_that_cannot_be_started_is_tried_again(plant: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
    plant.all_idle()
    start, refusals = start_process, iter([OSError(12, "Cannot allocate memory")])

    def refuse_once(*args: Any) -> Any:
        if (refusal := next(refusals, None)) is not None:
            raise refusal
        return start(*args)

    monkeypatch.setattr(module, "start_process", refuse_once)
    os.kill(plant.pid(0), signal.SIGKILL)
    plant.until(lambda: len(plant.lost) == 2)
    assert "Worker 0 could not be started ([Errno 12] Cannot allocate memory)" in plant.lost[1]
    plant.all_idle()
    assert plant.submit(plant.link()).get().error is None
