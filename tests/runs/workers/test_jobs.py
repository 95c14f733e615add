"""Jobs and replies survive pickling, and jobs describe themselves."""

from __future__ import annotations

import pickle
from dataclasses import replace

import pytest

from tests.runs.workers.conftest import CHECK, RingBoard
from vaoi_station.errors import GoneError
from vaoi_station.runs.workers.jobs import GatherJob, Linked, Priority, Reply
from vaoi_station.stitching.matching.evidence import Links


def test_results_come_before_pictures_and_heights_last() -> None:
    p = Priority
    assert sorted(p) == [
        p.CONCLUDE, p.LINK, p.GATHER, p.SMALL_RENDER, p.RENDER, p.BATCH, p.CHECK, p.IDENTITY, p.OVERVIEW, p.HEIGHTS
    ]  # fmt: skip


def test_evidence_is_packed_without_loss(ring_board: RingBoard) -> None:
    task = ring_board.tasks[0]
    linked = Linked.of(Links.empty(task, "nothing found"), 0.25)
    again = pickle.loads(pickle.dumps(linked))
    assert again == linked
    assert again.worker_s == 0.25
    assert again.evidence.task == task
    assert again.evidence is not again.evidence, "every access unpacks a new object"


def test_a_conclusion_leaves_out_the_evidence_that_a_worker_holds(ring_board: RingBoard) -> None:
    first, second, *_ = ring_board.tasks
    linked = {task: Linked.of(Links.empty(task, ""), 0.0) for task in (first, second)}
    job = ring_board.conclusion(linked, CHECK)
    assert job.without({first}) == replace(job, linked={second: linked[second]}, held=frozenset({first}))
    assert job.without(()) == job
    assert job.without({first, second}).check == CHECK


def test_jobs_name_their_run_and_frames(ring_board: RingBoard) -> None:
    task = next(task for task in ring_board.tasks if task.b is not None)
    job = ring_board.link(task)
    assert str(job) == f"{task.kind} of {task.a} and {task.b} of run r1"
    assert (job.run, job.affinity) == ("r1", task.a[0])
    assert str(GatherJob(ring_board.context, {})) == "gathering evidence of run r1"
    assert str(ring_board.conclusion({})) == "the conclusion of run r1"
    assert str(CHECK) == "the calibration check of run r1"


@pytest.mark.parametrize("reply", [Reply(b"picture", None, 0.1), Reply(None, GoneError("gone.", code="x"), 0.0)])
def test_replies_cross_the_pipe(reply: Reply) -> None:
    again = pickle.loads(pickle.dumps(reply))
    assert (again.value, str(again.error), again.worker_s) == (reply.value, str(reply.error), reply.worker_s)
