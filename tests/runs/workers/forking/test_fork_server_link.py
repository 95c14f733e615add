"""The station's side of the fork server: a server that hangs or cannot be started, and its end."""

from __future__ import annotations

import os
import resource
import signal
from multiprocessing import Pipe

import pytest

from tests.runs.workers.conftest import RingBoard
from tests.runs.workers.forking.served import PATIENCE_S, Served
from vaoi_station.runs.states.schemas import STARTING
from vaoi_station.runs.workers.forking import fork_server_link as module
from vaoi_station.runs.workers.forking.fork_server_link import ForkServerLink


def test_a_server_that_hangs_is_replaced(ring_board: RingBoard, monkeypatch: pytest.MonkeyPatch) -> None:
    """No call waits for it. The request that it has not answered is refused."""
    with Served() as served:
        victim = served.pid
        os.kill(victim, signal.SIGSTOP)
        with monkeypatch.context() as impatient:  # only now: the next server may start slowly
            impatient.setattr(module, "REPLY_LIMIT_S", 1.0)
            outcome, pipe = served.requested(str(ring_board.ring.path))
        assert outcome == "the fork server has ended"
        assert "did not answer for 1 s, so that the station ended it" in served.reports[0]
        pipe.close()
        served.until(lambda: served.link.ready)
        assert served.pid != victim
        process, pipe = served.started(str(ring_board.ring.path))
        pipe.close()
        assert served.code(process) == 0


def test_an_idle_server_answers_pings_and_one_that_hangs_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PING_INTERVAL_S", 0.02)
    with Served() as served:
        ages: list[float] = []

        def renewed() -> bool:
            ages.append(served.link.status().heartbeat_age_s or 0.0)
            return ages[-1] < max(ages)

        served.until(renewed)
        os.kill(served.pid, signal.SIGSTOP)
        with monkeypatch.context() as impatient:
            impatient.setattr(module, "REPLY_LIMIT_S", 0.5)
            served.until(lambda: bool(served.reports))
        assert "did not answer for 0.5 s" in served.reports[0]


def test_a_server_that_cannot_be_started_is_tried_again() -> None:
    reports: list[str] = []
    link = ForkServerLink(reports.append)
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
    assert 0.0 < link.pause_s() <= 0.25
    link.stop()


def test_no_worker_is_requested_of_an_absent_server() -> None:
    here, there = Pipe()
    with here, there, pytest.raises(BrokenPipeError, match="the fork server has ended"):
        ForkServerLink(print).request(0, "ring", there.fileno())


def test_a_server_that_still_starts_is_ended_at_once() -> None:
    served = Served()
    served.until(lambda: served.link.status().pid is not None)
    process = served.link._process
    assert process is not None
    assert served.link.status().doing == STARTING
    served.link.stop()
    assert process.exit_code == -signal.SIGKILL


def test_a_stopped_server_waits_for_its_workers(ring_board: RingBoard) -> None:
    with Served() as served:
        server = served.link._process
        assert server is not None
        process, pipe = served.started(str(ring_board.ring.path))
        pipe.close()
        assert process.has_ended(PATIENCE_S)
    assert server.exit_code == 0
