"""The main loop of a worker, in a real process."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, TypeAlias

import pytest

from tests.runs.workers.conftest import CHECK, RingBoard
from vaoi_station.drift.checks import RunCheck
from vaoi_station.runs.workers.jobs import CloseRun, Concluded, Ping, Reply, WorkerReady, WorkerStarting
from vaoi_station.runs.workers.worker_process import run_worker

PATIENCE_S = 120.0
Pipe: TypeAlias = "Connection[Any, Any]"


@pytest.fixture
def worker(ring_board: RingBoard) -> Iterator[tuple[BaseProcess, Pipe]]:
    spawn = multiprocessing.get_context("spawn")
    here, there = spawn.Pipe()
    process = spawn.Process(target=run_worker, args=(there, str(ring_board.ring.path)), daemon=True)
    process.start()
    there.close()
    yield process, here
    here.close()
    process.kill()
    process.join()
    process.close()


def receive(pipe: Pipe) -> Any:
    """Wait for the next message that does not report the progress of a slow warm-up."""
    while True:
        assert pipe.poll(PATIENCE_S)
        if not isinstance(message := pipe.recv(), WorkerStarting):
            return message


def test_a_worker_reports_its_result_then_its_check_and_ends_when_asked(
    worker: tuple[BaseProcess, Pipe], ring_board: RingBoard
) -> None:
    process, pipe = worker
    assert receive(pipe) == WorkerReady(process.pid or 0)
    pipe.send(Ping())
    assert isinstance(receive(pipe), WorkerReady)
    pipe.send(ring_board.opening)
    pipe.send(ring_board.link(*ring_board.tasks))
    links = receive(pipe)
    assert len(links.value) == len(ring_board.tasks)
    pipe.send(ring_board.conclusion({}, CHECK))
    pipe.send(CloseRun("r1"))
    result, check = receive(pipe), receive(pipe)
    assert isinstance(result, Reply)
    assert isinstance(result.value, Concluded)
    assert isinstance(check.value, RunCheck), "the evidence outlives a CloseRun that waits in the pipe"
    pipe.send(None)
    process.join(PATIENCE_S)
    assert process.exitcode == 0


def test_a_worker_ends_with_its_pipe(worker: tuple[BaseProcess, Pipe]) -> None:
    process, pipe = worker
    receive(pipe)
    pipe.close()
    process.join(PATIENCE_S)
    assert process.exitcode == 0
