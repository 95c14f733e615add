"""What is made of a run whose second half never came."""

from __future__ import annotations

from vaoi_station.acquisition.process.messages import FrameSettled, PulseReported
from vaoi_station.config import StationConfig
from vaoi_station.model import FrameRecord, Pulse, Verdict
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.salvage import CAUSE, salvage_recording
from vaoi_station.runs.workers.jobs import Linked, LinkJob, Reply
from vaoi_station.stitching.matching.evidence import Links


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
        nothing = Linked.of(Links.empty(task, "scripted"), 0.0)
        progress.add_evidence(LinkJob(progress.context, task.a[0], (task,), {}), Reply((nothing,), None, 0.0), 60.0)
    conclusion = progress.conclude_job()
    assert conclusion is not None
    assert conclusion.excluded == {task for task in progress.requested_s if task.a[1] == 3} != set(), (
        "also unanswered ones"
    )


def test_without_a_pulse_there_is_no_recording(config: StationConfig, progress: Progress) -> None:
    assert salvage_recording(progress, config) is None
    progress.pulses[1] = Pulse(index=1, time_s=3.0)
    assert salvage_recording(progress, config) is None
