"""The main loop of a worker, in a real process."""

from __future__ import annotations

from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any, TypeAlias

import pytest

from tests.runs.workers.conftest import CHECK, RingBoard
from tests.runs.workers.forking.served import PATIENCE_S, Served
from vaoi_station.drift.checks import RunCheck
from vaoi_station.runs.workers.forking.child_process import ChildProcess
from vaoi_station.runs.workers.jobs import CloseRun, Concluded, Ping, Reply, WorkerReady

Pipe: TypeAlias = "Connection[Any, Any]"


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    with Served() as made:
        yield made


@pytest.fixture
def worker(served: Served, ring_board: RingBoard) -> Iterator[tuple[ChildProcess, Pipe]]:
    process, pipe = served.started(str(ring_board.ring.path))
    yield process, pipe
    pipe.close()
    process.kill()
    served.code(process)


def receive(pipe: Pipe) -> Any:
    assert pipe.poll(PATIENCE_S)
    return pipe.recv()


def test_a_worker_reports_its_result_then_its_check_and_ends_when_asked(
    served: Served, worker: tuple[ChildProcess, Pipe], ring_board: RingBoard
) -> None:
    process, pipe = worker
    assert receive(pipe) == WorkerReady(process.pid)
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
    assert served.code(process) == 0


def test_a_worker_ends_with_its_pipe(served: Served, worker: tuple[ChildProcess, Pipe]) -> None:
    process, pipe = worker
    receive(pipe)
    pipe.close()
    assert served.code(process) == 0
