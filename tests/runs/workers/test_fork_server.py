"""The fork server, in a real process: what its workers have and must not have, and what happens when it fails."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Iterator
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeAlias

import pytest

from tests.runs.workers.conftest import CHECK, RingBoard
from tests.runs.workers.served import PATIENCE_S, Served
from vaoi_station.benchmarks.process_usage import cpu_s
from vaoi_station.runs.states.schemas import STARTING
from vaoi_station.runs.workers import fork_server_link as module
from vaoi_station.runs.workers.fork_server_link import ForkServerLink
from vaoi_station.runs.workers.jobs import CloseRun, Concluded, Explained, Numbered, Ping, WorkerReady

Pipe_: TypeAlias = "Connection[Any, Any]"


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    with Served() as made:
        yield made


@pytest.fixture
def ring(ring_board: RingBoard) -> str:
    return str(ring_board.ring.path)


def receive(pipe: Pipe_) -> Any:
    assert pipe.poll(PATIENCE_S)
    return pipe.recv()


def evidence_file(pid: int) -> str:
    """Return the inode of the evidence that a process maps."""
    lines = Path(f"/proc/{pid}/maps").read_text(encoding="utf-8").splitlines()
    return next(line.split()[4] for line in lines if "memfd:vaoi-evidence" in line)


def test_two_workers_share_their_evidence_and_end_when_asked_or_with_their_pipe(
    served: Served, ring: str, ring_board: RingBoard
) -> None:
    """One finds it, the other one concludes from it; results come before checks, and a run may be closed before one."""
    (finder, its_pipe), (owner, pipe) = (served.started(ring, index) for index in (0, 1))
    assert (receive(its_pipe), receive(pipe)) == (WorkerReady(finder.pid), WorkerReady(owner.pid))
    assert cpu_s(owner.pid) < 0.3, "a start by itself takes seconds"
    for end in (its_pipe, pipe):
        end.send(ring_board.opening)
    its_pipe.send(Numbered(1, ring_board.link(*ring_board.tasks)))
    assert len(receive(its_pipe).value) == len(ring_board.tasks)
    pipe.send(Numbered(2, ring_board.conclusion()))
    pipe.send(CloseRun("r1"))
    pipe.send(Numbered(3, CHECK))
    assert isinstance(receive(pipe).value, Concluded)
    assert isinstance(receive(pipe).value, Explained)
    pipe.send(Ping())
    assert isinstance(receive(pipe), WorkerReady)
    pipe.send(None)
    its_pipe.close()
    assert [served.code(process) for process in (finder, owner)] == [0, 0]


def test_workers_go_on_when_the_server_dies_and_it_is_replaced(ring: str, ring_board: RingBoard) -> None:
    with Served() as served:
        process, pipe = served.started(ring)
        receive(pipe)
        victim = served.pid
        os.kill(victim, signal.SIGKILL)
        served.until(lambda: bool(served.reports))
        assert served.reports == ["The fork server ended with code -9; it is restarted. Workers that run go on."]
        assert not served.link.will_report(process), "its exit code stays unknown"
        pipe.send(ring_board.opening)
        pipe.send(Numbered(1, ring_board.link(ring_board.tasks[0])))
        assert receive(pipe).error is None
        served.until(lambda: served.link.ready)
        assert (served.pid != victim, served.link.status().restarts) == (True, 1)
        server, (last, its_pipe) = served.link._process, served.started(ring, 1)
        receive(its_pipe)
        assert evidence_file(last.pid) == evidence_file(process.pid), "workers of both servers share it"
        pipe.close()
        assert process.has_ended(PATIENCE_S)
        its_pipe.close()
        assert last.has_ended(PATIENCE_S)
    assert server is not None
    assert server.exit_code == 0, "a server that is stopped ends after its workers"


def test_a_server_that_hangs_is_noticed_and_replaced(ring: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """No call waits for it. An idle one answers pings; a request that it has not answered is refused."""
    monkeypatch.setattr(module, "PING_INTERVAL_S", 0.02)
    with Served() as served:
        ages: list[float] = []

        def renewed() -> bool:
            ages.append(served.link.status().heartbeat_age_s or 0.0)
            return ages[-1] < max(ages)

        served.until(renewed)
        victim = served.pid
        os.kill(victim, signal.SIGSTOP)
        with monkeypatch.context() as impatient:  # only now: the next server may start slowly
            impatient.setattr(module, "REPLY_LIMIT_S", 1.0)
            outcome, pipe = served.requested(ring)
        assert outcome == "the fork server has ended"
        assert "did not answer for 1 s, so that the station ended it" in served.reports[0]
        pipe.close()


def test_a_server_that_cannot_be_started_is_tried_again() -> None:
    reports: list[str] = []
    link = ForkServerLink(reports.append, 1)
    here, there = Pipe()
    with here, there, pytest.raises(BrokenPipeError, match="the fork server has ended"):
        link.request(0, "ring", there.fileno())
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, before[1]))
    try:
        assert [*link.outcomes()] == []
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
    assert reports == ["The fork server could not be started ([Errno 24] Too many open files); it is tried again."]
    status = link.status()
    assert (status.name, status.pid, status.alive, status.doing) == ("fork server", None, False, STARTING)
    assert status.next_try is not None
    link.stop()
