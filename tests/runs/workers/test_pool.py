"""The pool with real worker processes: jobs survive workers that die or hang."""

from __future__ import annotations

import contextlib
import json
import os
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.runs.workers.conftest import CHECK, RingBoard
from tests.runs.workers.plant import BoardPlant, Plant, conclusion, numbers
from tests.runs.workers.served import few_files
from vaoi_station.errors import InternalError, StateError
from vaoi_station.runs.workers import fork_server_link
from vaoi_station.runs.workers import pool as module
from vaoi_station.runs.workers.jobs import Explained


def test_jobs_of_a_killed_worker_are_repeated(plant: Plant) -> None:
    plant.all_idle()
    victim = plant.pid(0)
    os.kill(victim, signal.SIGSTOP)
    pending = [plant.submit(plant.link(0, row)) for row in (0, 1, 0, 1)]
    assert "rows of (0, 0)" in plant.pool.status()[0].doing
    os.kill(victim, signal.SIGKILL)
    answers = [p.get() for p in pending]
    assert all(answer.error is None for answer in answers)
    plant.until(lambda: len(plant.lost) == 1)
    assert "Worker 0 ended with code -9 while doing rows of (0, 0)" in plant.lost[0]
    plant.all_idle()
    assert plant.restarts == [1, 0]
    assert plant.pid(0) != victim
    assert all(len(p.answers) == 1 for p in pending)


def test_a_job_that_ends_two_workers_is_given_up(plant: Plant) -> None:
    plant.all_idle()
    for worker in (0, 1):
        os.kill(plant.pid(worker), signal.SIGSTOP)
    pending = plant.submit(plant.link())
    first, second = plant.pid(0), plant.pid(1)
    os.kill(first, signal.SIGKILL)
    plant.until(lambda: "rows of" in plant.pool.status()[1].doing)
    os.kill(second, signal.SIGKILL)
    answer = pending.get()
    assert isinstance(answer.error, InternalError)
    assert answer.error.code == "worker-lost"
    assert "was given up after 2 attempt(s)" in answer.error.message
    assert "vaoi bundle" in answer.error.action
    plant.all_idle()
    assert plant.submit(plant.link()).get().error is None


def test_a_worker_that_hangs_is_replaced(plant: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
    plant.all_idle()
    monkeypatch.setattr(module, "PING_INTERVAL_S", 0.05)
    monkeypatch.setattr(module, "JOB_LIMIT_S", 2.0)
    victim, before = plant.pid(1), plant.complete
    os.kill(victim, signal.SIGSTOP)
    plant.until(lambda: len(plant.lost) > 0)
    assert any("Worker 1 did not answer for 2 s, so that the station ended it" in words for words in plant.lost)
    plant.all_idle()
    assert plant.pid(1) != victim
    plant.until(lambda: plant.complete > before)


def test_a_new_owner_concludes_from_the_evidence_of_all(plant: Plant, make_head: Any) -> None:
    """The owner of the run dies with all that it has gathered."""
    plant.all_idle()
    jobs = [plant.link(camera, row) for row in range(2) for camera in (0, 1)]
    assert all(plant.submit(job).get().error is None for job in jobs)
    whole = conclusion(plant, make_head(3), jobs)
    gathered = numbers(plant.submit(whole).get())
    assert len(gathered["quality"]["unlinked"]) == 4, "equal frames do not move, but each pair was evaluated"
    os.kill(plant.pid(1), signal.SIGKILL)
    plant.until(lambda: len(plant.lost) == 1)
    plant.all_idle()
    assert numbers(plant.submit(whole).get()) == gathered


def test_a_conclusion_whose_worker_dies_is_repeated_by_another(plant: Plant, make_head: Any) -> None:
    plant.all_idle()
    jobs = [plant.link(camera) for camera in (0, 1)]
    assert all(plant.submit(job).get().error is None for job in jobs)
    plant.all_idle()
    os.kill(plant.pid(1), signal.SIGSTOP)
    job = conclusion(plant, make_head(3), jobs)
    pending = plant.submit(job)
    assert "the conclusion of run r1" in plant.pool.status()[1].doing
    os.kill(plant.pid(1), signal.SIGKILL)
    assert numbers(pending.get()) == numbers(plant.submit(job).get())


def test_stopping_reports_every_job_and_leaves_no_process(tmp_path: Path) -> None:
    plant = Plant(tmp_path)
    plant.until(lambda: plant.complete == 1)
    pids = [plant.pid(0), plant.pid(1)]
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    pending = [plant.submit(plant.link(0, 0)) for _ in range(4)]
    plant.pool.stop(timeout_s=0.1)
    assert all(isinstance(p.get().error, StateError) for p in pending)
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    assert isinstance(plant.submit(plant.link()).get().error, StateError)
    plant.close()


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


def test_a_conclusion_does_not_wait_for_a_worker_that_hangs(board_plant: BoardPlant, ring_board: RingBoard) -> None:
    board_plant.link_all([ring_board.link(task) for task in ring_board.tasks])
    board_plant.all_idle()
    victim = board_plant.pid(1)
    os.kill(victim, signal.SIGSTOP)
    try:
        result = board_plant.submit(ring_board.conclusion())
        assert result.get().error is None
        checked = board_plant.submit(CHECK)
        assert isinstance(checked.get().value, Explained), "by the worker that has concluded"
    finally:
        with contextlib.suppress(ProcessLookupError):  # a worker that was outrun is killed after some seconds
            os.kill(victim, signal.SIGCONT)
    board_plant.all_idle()
    assert [len(p.answers) for p in (result, checked)] == [1, 1], "result and check of the slower worker are dropped"


def test_a_result_whose_worker_dies_is_concluded_again_to_be_explained(
    board_plant: BoardPlant, ring_board: RingBoard
) -> None:
    board_plant.link_all([ring_board.link(task) for task in ring_board.tasks])
    board_plant.all_idle()
    result = board_plant.submit(ring_board.conclusion())
    assert result.get().error is None
    os.kill(board_plant.pid(1), signal.SIGKILL)
    error = board_plant.submit(CHECK).get().error
    assert isinstance(error, InternalError)
    assert "the worker that concluded the run has ended" in error.message
    again = board_plant.submit(replace(CHECK, again=(ring_board.opening, ring_board.conclusion()))).get().value
    first, whole = (json.loads(text) for text in (result.get().value.document, again.document.value))
    assert whole["image_matrices"] == first["image_matrices"]
    assert set(first["quality"].pop("later")) <= set(whole["quality"])
    assert again.check.error is None


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
