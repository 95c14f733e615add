"""What stitches a run: which links it asks for and when, what the result needs, and what it answers."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.runs.doubles import Workers
from vaoi_station.errors import InternalError
from vaoi_station.model import FrameRecord, Pulse, RecordingHead, Verdict
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.workers.jobs import ConcludeJob, LinkJob, WorkerLostError
from vaoi_station.runs.workers.run_stitcher import RunStitcher, Stitched
from vaoi_station.stitching.matching.evidence import Task

ROWS = 3
KEYS = [(camera, row) for row in range(ROWS) for camera in (0, 1)]


class Stitching:
    """A stitcher with its workers and its answers."""

    def __init__(self, progress: Progress) -> None:
        self.stitcher, self.workers = RunStitcher(progress.stitcher.opening, 50.0), Workers()
        self.answers: list[Stitched] = []
        self.stitcher.start(self.workers, self.answers.append)

    @property
    def tasks(self) -> list[Task]:
        return [task for job in self.workers.of(LinkJob) for task in job.tasks]

    @property
    def conclusions(self) -> list[ConcludeJob]:
        return self.workers.of(ConcludeJob)

    def pulse(self, *rows: int) -> None:
        for row in rows:
            self.stitcher.pulses[row] = Pulse(index=row, time_s=100 + 0.1 * row)

    def settle(self, camera: int, row: int, verdict: Verdict = Verdict.OK) -> None:
        record = FrameRecord(camera=camera, row=row, verdict=verdict, slot=10 * camera + row)
        self.stitcher.settle(record, 51.0 + row)

    def film(self, head: RecordingHead, order: Iterable[tuple[int, int]] = KEYS) -> None:
        self.pulse(*range(ROWS))
        for key in order:
            self.settle(*key)
        self.stitcher.film(head, [*self.stitcher.frames.values()])


@pytest.fixture
def stitching(progress: Progress) -> Stitching:
    return Stitching(progress)


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(order=st.permutations(KEYS))
def test_what_the_result_needs_does_not_depend_on_the_order_of_arrival(
    progress: Progress, make_head: Callable[[int], RecordingHead], order: list[tuple[int, int]]
) -> None:
    one, other = Stitching(progress), Stitching(progress)
    one.film(make_head(ROWS))
    other.film(make_head(ROWS), order)
    assert {*one.tasks} == {*other.tasks}
    assert len(other.tasks) == len({*other.tasks}), "no task is requested twice"


def test_the_conclusion_follows_the_last_evidence_and_is_the_answer(stitching: Stitching, make_head: Any) -> None:
    stitching.film(make_head(ROWS))
    for job in stitching.workers.of(LinkJob):
        assert stitching.conclusions == []
        stitching.workers.answer(job)
    [conclusion] = stitching.conclusions
    assert {*conclusion.tasks} == {*stitching.tasks}
    assert conclusion.slots == {(camera, row): 10 * camera + row for camera, row in KEYS}
    result: Any = object()
    stitching.workers.answer(conclusion, result)
    [answer] = stitching.answers
    assert (answer.result, answer.errors, answer.conclude_ms) == (result, (), 250.0)
    assert answer.ready_s is not None
    assert [t.worker_ms for t in answer.timings] == [500.0] * len(stitching.tasks)


def test_a_failed_link_only_loses_its_evidence_and_a_failed_conclusion_leaves_no_result(
    stitching: Stitching, make_head: Any
) -> None:
    stitching.film(make_head(ROWS))
    first, *rest = stitching.workers.of(LinkJob)
    stitching.workers.answer(first, error=InternalError("the link broke"))
    for job in rest:
        stitching.workers.answer(job)
    [conclusion] = stitching.conclusions
    assert {*conclusion.tasks} == {*stitching.tasks} - {*first.tasks}
    stitching.workers.answer(conclusion, error=InternalError("singular"))
    [answer] = stitching.answers
    assert ([error.message for error in answer.errors], answer.ready_s) == (["the link broke", "singular"], None)


def test_a_link_that_killed_workers_ends_the_run_without_a_result_and_later_replies_are_ignored(
    stitching: Stitching, make_head: Any
) -> None:
    stitching.film(make_head(ROWS))
    lost, *rest = stitching.workers.of(LinkJob)
    stitching.workers.answer(lost, error=WorkerLostError("two workers died"))
    [answer] = stitching.answers
    assert (answer.result, [error.code for error in answer.errors]) == (None, ["worker-lost"])
    for job in rest:
        stitching.workers.answer(job)
    assert (stitching.conclusions, len(stitching.answers)) == ([], 1)
