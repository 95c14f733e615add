"""Runs under way: which jobs are submitted, in which order runs end, and what becomes of one that was cut short."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from tests.runs.doubles import Workers
from vaoi_station.acquisition.process.messages import FrameSettled, PulseReported, RunFinished
from vaoi_station.config import StationConfig
from vaoi_station.errors import InternalError
from vaoi_station.files.results import without_components
from vaoi_station.model import FrameRecord, Pulse, Reason, RecordingHead, Status, Stitch, Verdict
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.control.active_runs import CAUSE, ActiveRuns, salvage_recording
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.states.tables import RunState
from vaoi_station.runs.workers.jobs import CheckJob, Concluded, ConcludeJob, LinkJob, Reply
from vaoi_station.store import Store


@pytest.fixture
def workers() -> Workers:
    return Workers()


@pytest.fixture
def archive(store: Store) -> Archive:
    return Archive(store, EventLog(store))


@pytest.fixture
def runs(workers: Workers, archive: Archive, store: Store) -> ActiveRuns:
    return ActiveRuns(workers, workers.jobs.append, archive, EventLog(store))


@pytest.fixture
def second(progress: Progress) -> Progress:
    """Return the run behind `progress`."""
    context = replace(progress.context, run="r2", bay=2)
    return Progress(progress.order, replace(progress.opening, context=context), 60.0)


def film(runs: ActiveRuns, progress: Progress, make_head: Callable[[int], RecordingHead]) -> list[Progress]:
    """One row passes; returns the runs that have ended."""
    run = progress.run
    runs.open(progress)
    runs.pulse(PulseReported(run, Pulse(index=0, time_s=100.0)))
    frames = tuple(FrameRecord(camera=k, row=0, verdict=Verdict.OK, slot=k) for k in (0, 1))
    for frame in frames:
        runs.settle(FrameSettled(run, frame, 51.0))
    return runs.filmed(RunFinished(run, progress.context.bay, make_head(1), frames, 52.0, "clear"))


def reply_links(runs: ActiveRuns, workers: Workers, run: str) -> list[Progress]:
    ended = []
    for job in [job for job in workers.jobs if isinstance(job, LinkJob) and job.run == run]:
        ended += runs.linked(job, Reply((0.1,) * len(job.tasks), None, 0.1), 53.0)
    return ended


def conclude(runs: ActiveRuns, workers: Workers, run: str, stitch: Stitch) -> list[Progress]:
    [job] = [job for job in workers.jobs if isinstance(job, ConcludeJob) and job.run == run]
    return runs.concluded(job, Reply(Concluded(without_components(stitch), stitch.model_dump_json()), None, 0.2), 54.0)


@pytest.mark.parametrize(
    ("status", "state"),
    [(Status.OK, RunState.READY), (Status.DEGRADED, RunState.DEGRADED), (Status.FAILED, RunState.FAILED)],
)
def test_a_run_is_concluded_after_its_last_link_and_ends_with_the_stitchs_verdict(
    runs: ActiveRuns, workers: Workers, progress: Progress, make_head: Any, make_stitch: Any,
    status: Status, state: RunState,
) -> None:  # fmt: skip
    assert film(runs, progress, make_head) == []
    assert runs.filming == []
    assert not any(isinstance(job, ConcludeJob) for job in workers.jobs)
    assert reply_links(runs, workers, "r1") == []
    assert conclude(runs, workers, "r1", make_stitch(make_head(1), status)) == [progress]
    assert progress.state is state
    assert (runs.active, workers.open) == ({}, [])
    checks = sum(isinstance(job, CheckJob) for job in workers.jobs)
    assert checks == (status is not Status.FAILED), "a failed result is no evidence of drift"


def test_an_early_result_waits_for_the_run_before_it(
    runs: ActiveRuns, workers: Workers, progress: Progress, second: Progress, make_head: Any, make_stitch: Any
) -> None:
    film(runs, progress, make_head)
    film(runs, second, make_head)
    for run in ("r2", "r1"):
        reply_links(runs, workers, run)
    stitch = make_stitch(make_head(1))
    assert conclude(runs, workers, "r2", stitch) == []
    assert conclude(runs, workers, "r1", stitch) == [progress, second]


def test_a_fault_makes_a_sound_result_degraded(
    runs: ActiveRuns, workers: Workers, progress: Progress, make_head: Any, make_stitch: Any
) -> None:
    film(runs, progress, make_head)
    progress.add_fault(Reason(code="run-cut-short", message="The controller was reset."))
    reply_links(runs, workers, "r1")
    conclude(runs, workers, "r1", make_stitch(make_head(1)))
    assert progress.state is RunState.DEGRADED


def test_a_run_that_cannot_be_stitched_ends_at_once_and_late_replies_are_ignored(
    runs: ActiveRuns, workers: Workers, progress: Progress, make_head: Any
) -> None:
    film(runs, progress, make_head)
    [job, *_] = [job for job in workers.jobs if isinstance(job, LinkJob)]
    lost = Reply(None, InternalError("it died", code="worker-lost"), 0.0)
    assert runs.linked(job, lost, 53.0) == [progress]
    assert progress.state is RunState.FAILED
    assert runs.linked(job, lost, 53.0) == []


def test_reports_of_unknown_runs_are_ignored(runs: ActiveRuns, workers: Workers, make_head: Any) -> None:
    runs.pulse(PulseReported("never", Pulse(index=0, time_s=1.0)))
    runs.settle(FrameSettled("never", FrameRecord(camera=0, row=0, verdict=Verdict.OK, slot=0), 1.0))
    assert runs.filmed(RunFinished("never", 0, make_head(1), (), 1.0, "clear")) == []
    assert workers.jobs == []


def test_rows_with_a_certain_time_are_kept_and_the_rest_is_missing(config: StationConfig, progress: Progress) -> None:
    for index, time_s in ((0, 9.0), (1, 9.1000000004), (3, 9.3)):
        progress.pulses[PulseReported("r1", Pulse(index=index, time_s=time_s)).pulse.index] = Pulse(
            index=index, time_s=time_s
        )
    for camera, row, at in ((0, 0, 51.0), (1, 0, 51.5), (0, 1, 52.0), (0, 3, 53.0)):
        record = FrameRecord(camera=camera, row=row, verdict=Verdict.OK, slot=row)
        progress.settle(FrameSettled("r1", record, at))
    film = salvage_recording(progress, config)
    assert film is not None
    assert film.head.rows == 2
    assert film.head.trigger_times_s == (0.0, 0.1)
    assert film.head.missing == ((1, 1),)
    assert [(f.camera, f.row, f.verdict) for f in film.frames] == [
        (0, 0, Verdict.OK),
        (0, 1, Verdict.OK),
        (1, 0, Verdict.OK),
        (1, 1, Verdict.MISSING),
    ]
    assert film.frames[-1].cause == CAUSE
    assert (film.bay, film.reason) == (1, "acquisition lost")
    progress.filmed(film)
    for task in progress.canonical_tasks:
        progress.add_links(LinkJob(progress.context, task.a[0], (task,), {}), Reply((0.1,), None, 0.1), 60.0)
    conclusion = progress.conclude_job()
    assert conclusion is not None
    left_out = {*progress.requested_s} - {*conclusion.tasks}
    assert left_out == {task for task in progress.requested_s if task.a[1] == 3} != set(), "also unanswered ones"


def test_without_a_pulse_there_is_no_recording(config: StationConfig, progress: Progress) -> None:
    assert salvage_recording(progress, config) is None
    progress.pulses[1] = Pulse(index=1, time_s=3.0)
    assert salvage_recording(progress, config) is None
