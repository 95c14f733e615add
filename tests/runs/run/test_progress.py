"""The progress of one run: which jobs become possible when, and what counts in the end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vaoi_station.acquisition.process.messages import FrameSettled, RunFinished
from vaoi_station.errors import InternalError, StateError
from vaoi_station.model import FrameRecord, Pulse, Reason, RecordingHead, Stitch, Verdict
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.states.tables import RunState, RunStep
from vaoi_station.runs.workers.jobs import CheckJob, Concluded, LinkJob, Reply
from vaoi_station.stitching.matching.evidence import Task

ROWS = 3
KEYS = [(camera, row) for row in range(ROWS) for camera in (0, 1)]


def settle(progress: Progress, camera: int, row: int, verdict: Verdict = Verdict.OK) -> list[LinkJob]:
    record = FrameRecord(camera=camera, row=row, verdict=verdict, slot=10 * camera + row)
    return progress.settle(FrameSettled("r1", record, 51.0 + row))


def pulse(progress: Progress, row: int) -> None:
    progress.pulses[row] = Pulse(index=row, time_s=100 + 0.1 * row)


def check_of(progress: Progress, head: RecordingHead, reason: str, stitch: Stitch) -> CheckJob | None:
    """Film and conclude a run whose pulses ended for a reason, and return the check that follows."""
    jobs = []
    for row in range(ROWS):
        pulse(progress, row)
        jobs += [job for camera in (0, 1) for job in settle(progress, camera, row)]
    jobs += progress.filmed(replace(report(progress, head), reason=reason))
    for job in jobs:
        progress.add_links(job, found(job), 56.0)
    assert progress.check_job() is None
    assert progress.conclude_job() is not None
    progress.add_result(Reply(Concluded(stitch, ""), None, 0.1), 57.0)
    return progress.check_job()


def tasks_of(jobs: list[LinkJob]) -> list[Task]:
    return [task for job in jobs for task in job.tasks]


def report(progress: Progress, head: RecordingHead) -> RunFinished:
    frames = tuple(progress.frames[key] for key in sorted(progress.frames))
    return RunFinished("r1", 1, head, frames, 55.0, "clear")


def found(job: LinkJob) -> Reply:
    return Reply((0.5,) * len(job.tasks), None, 0.5)


def filmed(progress: Progress, head: RecordingHead) -> list[LinkJob]:
    """Settle all frames in order, then finish; returns all jobs."""
    jobs = []
    for row in range(ROWS):
        pulse(progress, row)
        jobs += [job for camera in (0, 1) for job in settle(progress, camera, row)]
    return jobs + progress.filmed(report(progress, head))


@pytest.mark.parametrize("reason", ["disarmed", "acquisition lost", "max-rows", "the controller stopped reporting"])
def test_a_run_that_was_cut_short_is_no_evidence_of_drift(
    progress: Progress, make_head: Callable[..., RecordingHead], make_stitch: Any, reason: str
) -> None:
    assert check_of(progress, make_head(ROWS), reason, make_stitch(make_head(ROWS))) is None


def test_a_whole_run_is_evidence_of_drift(progress: Progress, make_head: Any, make_stitch: Any) -> None:
    check = check_of(progress, make_head(ROWS), "clear", make_stitch(make_head(ROWS)))
    assert check is not None
    assert check.run == "r1"
    assert check.board_type == progress.order.board_type.filmed_digest()


def test_a_task_is_requested_once_both_of_its_frames_are_there(progress: Progress) -> None:
    pulse(progress, 0)
    pulse(progress, 1)
    first = tasks_of(settle(progress, 0, 0))
    assert all(task.b is None for task in first)
    second = tasks_of(settle(progress, 0, 1))
    assert ("rows", (0, 0), (0, 1)) in [(t.kind, t.a, t.b) for t in second]
    assert not {*first} & {*second}


def test_frames_that_are_not_whole_or_have_no_pulse_are_not_linked(progress: Progress) -> None:
    assert settle(progress, 0, 0) == []
    pulse(progress, 0)
    assert settle(progress, 1, 0, Verdict.INCOMPLETE) == []
    assert progress.present == ((0, 0),)


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(order=st.permutations(KEYS))
def test_the_canonical_tasks_do_not_depend_on_the_order_of_arrival(
    progress: Progress, make_head: Callable[[int], RecordingHead], order: list[tuple[int, int]]
) -> None:
    one = Progress(progress.order, progress.opening, progress.barrier_s)
    other = Progress(progress.order, progress.opening, progress.barrier_s)
    head = make_head(ROWS)
    filmed(one, head)
    for row in range(ROWS):
        pulse(other, row)
    requested = [task for key in order for task in tasks_of(settle(other, *key))]
    requested += tasks_of(other.filmed(report(other, head)))
    assert {*one.canonical_tasks} == {*other.canonical_tasks} == {*requested}
    assert len(requested) == len({*requested}), "no task is requested twice"


def test_the_conclusion_follows_the_last_canonical_evidence(progress: Progress, make_head: Any) -> None:
    jobs = filmed(progress, make_head(ROWS))
    for job in jobs:
        assert progress.conclude_job() is None
        progress.add_links(job, found(job), 60.0)
    conclusion = progress.conclude_job()
    assert conclusion is not None
    assert {*conclusion.tasks} == {*progress.canonical_tasks} == {*tasks_of(jobs)}
    assert conclusion.slots == {(camera, row): 10 * camera + row for camera, row in KEYS}
    assert progress.conclude_job() is None, "it is submitted once"
    assert [t.done_s for t in progress.timings] == [10.0] * len(progress.timings)


def test_a_failed_job_is_a_fault_and_one_that_killed_workers_ends_the_run(progress: Progress, make_head: Any) -> None:
    first, second, *rest = filmed(progress, make_head(ROWS))
    progress.add_links(first, Reply(None, InternalError("the link broke"), 0.0), 60.0)
    assert ([f.message for f in progress.faults], progress.unstitchable) == (["the link broke"], False)
    assert progress.failed == {*first.tasks}
    progress.add_links(second, Reply(None, InternalError("it died", code="worker-lost"), 0.0), 60.0)
    assert progress.unstitchable
    for job in rest:
        progress.add_links(job, found(job), 60.0)
    assert progress.conclude_job() is None


def test_a_failed_conclusion_leaves_no_result(progress: Progress) -> None:
    progress.add_result(Reply(None, InternalError("singular"), 0.25), 60.0)
    assert (progress.stitch, progress.ready_s, progress.conclude_ms) == (None, None, 250.0)
    assert progress.unstitchable


def test_faults_are_listed_once_and_states_follow_the_table(progress: Progress) -> None:
    for _ in range(2):
        progress.add_fault(Reason(code="x", message="once"))
    assert len(progress.faults) == 1
    with pytest.raises(StateError):
        progress.advance(RunStep.STITCHED)
    assert progress.state is RunState.FILMING
    assert progress.head is None
