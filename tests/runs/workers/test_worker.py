"""When a worker is overdue."""

from __future__ import annotations

from collections import deque

import pytest

from tests.runs.workers.conftest import CHECK
from vaoi_station.runs.workers.jobs import LinkJob, Priority, RunContext
from vaoi_station.runs.workers.worker import OVERDUE_S, PING_OVERDUE_S, Queued, Worker

LINK = LinkJob(RunContext("r1", 0, 1), 0, (), {})


def test_a_worker_is_overdue_when_its_job_takes_much_longer_than_usual() -> None:
    worker = Worker(0, ready=True, jobs=deque([Queued(LINK)]), since_s=10.0)
    assert worker.due_s() == 10.0 + OVERDUE_S[Priority.LINK]
    for now_s, overdue in ((10.5, False), (12.0, True)):
        worker.update(now_s)
        assert worker.overdue is overdue


def test_a_worker_is_overdue_when_it_does_not_answer() -> None:
    worker = Worker(0, ready=True)
    assert worker.due_s() is None
    worker.pinged_s = 10.0
    assert worker.due_s() == 10.0 + PING_OVERDUE_S


def test_a_worker_that_starts_is_not_overdue() -> None:
    worker = Worker(0, since_s=0.0)
    worker.update(100.0)
    assert not worker.overdue


@pytest.mark.parametrize(("queued", "repeatable"), [
    (Queued(LINK), True), (Queued(LINK, done=True), False), (Queued(CHECK), False),
])  # fmt: skip
def test_what_may_be_repeated(queued: Queued, repeatable: bool) -> None:
    assert queued.repeatable is repeatable


def test_a_worker_without_a_process_has_nothing_to_end() -> None:
    worker = Worker(0)
    worker.kill()
    worker.end()
    assert worker.process is None
