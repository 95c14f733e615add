"""The choice of the worker for each job, with workers that are plain data."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.runs.workers.conftest import CHECK, RingBoard
from vaoi_station.runs.batches.batch_job import BatchJob
from vaoi_station.runs.workers.jobs import (
    ConcludeJob,
    ExplainJob,
    Job,
    LinkJob,
    OpenRun,
    Priority,
    RunContext,
)
from vaoi_station.runs.workers.picture_jobs import RenderJob
from vaoi_station.runs.workers.queues import JobQueues, Queued, Worker
from vaoi_station.stitching.matching.evidence import Task


def queued(job: Job, deaths: int = 0) -> Queued:
    return Queued(job, lambda _: None, deaths=deaths)


class Hall:
    """Queues over k ready workers, with one open run of three cameras."""

    def __init__(self, board: RingBoard, count: int) -> None:
        self.board = board
        self.workers = [Worker(k, ready=True) for k in range(count)]
        self.queues = JobQueues(self.workers)
        self.queues.runs["r1"] = board.opening

    def link(self, camera: int, row: int = 0, run: str = "r1") -> LinkJob:
        context = RunContext(run, 0, 1)
        return LinkJob(context, camera, (Task("rows", (camera, row), (camera, row + 1), 0.1),), {})

    def picture(self) -> RenderJob:
        return RenderJob("r1", 0, 1, 0, None, "png")  # type: ignore[arg-type]  # the queues do not read the view

    def add(self, *jobs: Job) -> None:
        for job in jobs:
            self.queues.add(queued(job))

    def choose(self, worker: int) -> Job | None:
        queued = self.queues.choose(self.workers[worker])
        if queued is not None:
            self.workers[worker].jobs.append(queued)
        return None if queued is None else queued.job


@pytest.fixture
def hall(ring_board: RingBoard) -> Hall:
    return Hall(ring_board, 3)


@pytest.mark.parametrize("busy_with", ["picture", "check"])
def test_a_conclusion_does_not_wait_for_a_picture_or_a_check(hall: Hall, busy_with: str) -> None:
    hall.workers[2].jobs = deque([queued(hall.picture() if busy_with == "picture" else CHECK)])
    hall.add(hall.board.conclusion())
    assert isinstance(hall.choose(0), ConcludeJob)


def test_closing_a_run_drops_its_links_and_keeps_its_check_and_pictures(hall: Hall) -> None:
    hall.queues.runs["r2"] = OpenRun(replace(hall.board.context, run="r2"), hall.board.setup)
    hall.add(hall.link(0), hall.link(0, run="r2"), hall.picture(), CHECK)
    hall.queues.forget("r1")
    assert [q.job for q in hall.queues.emptied()] == [hall.link(0, run="r2"), CHECK, hall.picture()]
    assert set(hall.queues.runs) == {"r2"}


@settings(max_examples=60, deadline=None)
@given(
    cameras=st.lists(st.integers(0, 2), max_size=12),
    order=st.lists(st.integers(0, 2), min_size=40, max_size=40),
    count=st.integers(1, 3),
)
def test_every_job_is_given_out_exactly_once(
    ring_board: RingBoard, cameras: list[int], order: list[int], count: int
) -> None:
    """Whatever the order in which workers become idle, no job is lost, repeated, or left to a worker that waits."""
    hall = Hall(ring_board, count)
    jobs: list[Job] = [hall.link(camera, row) for row, camera in enumerate(cameras)]
    hall.add(*jobs, hall.picture())
    chosen: list[Job] = []
    for worker in [*(k % count for k in order), *(list(range(count)) * 14)]:
        if (job := hall.choose(worker)) is not None:
            chosen.append(job)
        hall.workers[worker].jobs.clear()
    assert sorted(map(repr, chosen)) == sorted(map(repr, [*jobs, hall.picture()]))
    assert {job.priority for job in chosen} <= {Priority.LINK, Priority.RENDER}


@settings(max_examples=60, deadline=None)
@given(
    steps=st.lists(
        st.tuples(st.sampled_from(["link", "picture", "conclude", "finish"]), st.integers(0, 3)), max_size=60
    ),
    count=st.integers(2, 4),
)
def test_a_conclusion_never_waits_behind_pictures(
    ring_board: RingBoard, steps: list[tuple[str, int]], count: int
) -> None:
    """In any order of arrivals and of ends: when a picture begins, another worker could take a conclusion at once."""
    hall = Hall(ring_board, count)
    for step, k in steps:
        if step == "finish":
            if any(isinstance(q.job, ConcludeJob) for q in hall.workers[k % count].jobs):
                hall.queues.concluded("r1", hall.workers[k % count])
                hall.add(CHECK)
            hall.workers[k % count].jobs.clear()
        elif step == "conclude":
            hall.add(hall.board.conclusion())
        else:
            hall.add(hall.link(k % 3) if step == "link" else hall.picture())
        begun = [hall.choose(worker) for worker in range(count) if hall.workers[worker].idle]
        late = [worker.job for worker in hall.workers if worker.job and worker.job.priority > Priority.LINK]
        assert len(late) < count or not any(isinstance(job, RenderJob | ExplainJob) for job in begun)


def test_a_job_in_spare_time_is_as_urgent_as_pictures_while_a_caller_waits_for_it(hall: Hall) -> None:
    hall.queues.runs.clear()
    spare = replace(hall.picture(), priority=Priority.HEIGHTS)
    other, later = replace(spare, run="r2"), replace(hall.picture(), run="r3")
    hall.add(other, spare)
    hall.queues.hasten(RenderJob, "r1", 1)
    hall.add(later)
    chosen = []
    for _ in range(3):
        chosen.append(hall.choose(0))
        hall.workers[0].jobs.clear()
    assert chosen == [spare, later, other]


def part_of_a_batch() -> BatchJob:
    return BatchJob("r0", 0, 1, b"", (), {})


def test_parts_of_batches_come_after_pictures_and_take_every_worker_while_no_run_is_open(hall: Hall) -> None:
    hall.queues.runs.clear()
    hall.add(part_of_a_batch(), part_of_a_batch(), part_of_a_batch(), hall.picture())
    assert hall.choose(0) == hall.picture()
    assert [hall.choose(k) for k in (1, 2)] == [part_of_a_batch()] * 2


def test_no_picture_is_begun_beside_a_conclusion_unless_another_worker_is_free(ring_board: RingBoard) -> None:
    """It would delay the matrices, and then the check of the calibration."""
    for count, expected in ((2, None), (3, True)):
        hall = Hall(ring_board, count)
        hall.workers[-1].jobs.append(queued(hall.board.conclusion()))
        hall.add(hall.picture())
        assert (hall.choose(0) is not None) == bool(expected)
