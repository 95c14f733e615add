"""Runs that have not ended. Their tasks go to the workers as frames arrive. Their results go to the archive.

| state of a run | what happens | what follows |
|---|---|---|
| filming | a pulse, a frame | the tasks that become possible go to the workers |
| filming | the last frame is settled | stitching; the remaining tasks go to the workers |
| filming | the acquisition process ends | as if the last frame was settled, with what had arrived |
| stitching | the last task is done | the conclusion goes to the owner of the evidence |
| stitching | a job has ended two workers | the run is done, without a result |
| stitching | the conclusion is there | the run is done; the check of the calibration goes to the same worker |
| done | all earlier runs have ended | ready, degraded or failed; the archive stores and announces it |
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from typing import Protocol

from vaoi_station.acquisition.process.messages import FrameSettled, PulseReported, RunFinished
from vaoi_station.config import StationConfig
from vaoi_station.line_config import row_ways_mm
from vaoi_station.model import CameraHead, FrameRecord, Reason, RecordingHead, Status, Verdict
from vaoi_station.model.recording import row_of
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.run.progress import WHOLE, Progress
from vaoi_station.runs.run.verdict import conclude, with_faults
from vaoi_station.runs.states.tables import RunState, RunStep
from vaoi_station.runs.workers.jobs import CheckJob, ConcludeJob, Job, LinkJob, OpenRun, PictureJob, Reply

CAUSE = "the acquisition process ended before it arrived"
"""Cause of missing frames that is stated in their records."""


class Workers(Protocol):
    """The worker pool."""

    def submit(self, job: Job, done: Callable[[Reply], object]) -> None:
        """Queue a job for a worker. `done` gets its reply, in any thread, and must return at once."""

    def open_run(self, opening: OpenRun) -> None:
        """Announce a run to the pool, before its first job is submitted."""

    def close_run(self, run: str) -> None:
        """Make the pool and the workers discard everything that they hold for a run."""

    def hastened(self, kind: type[PictureJob], run: str) -> AbstractContextManager[None]:
        """Within a `with` block, do spare-time jobs of a kind and a run as if a caller had submitted them."""


class ActiveRuns:
    """The runs that are being filmed or stitched, in the order of their boards. Used by the coordinator's thread only.

    Methods that may end runs return the runs that have ended, oldest first.
    """

    def __init__(
        self,
        workers: Workers,
        submit: Callable[[LinkJob | ConcludeJob | CheckJob], object],
        archive: Archive,
        events: EventLog,
        before_end: Callable[[Progress], None] = lambda _progress: None,
    ) -> None:
        """Begin without runs.

        Args:
            workers: the worker pool, to which runs are announced.
            submit: queues a job, whose reply comes back to the coordinator's thread.
            archive: takes the runs that have ended.
            events: the event log.
            before_end: is called with each run before its final state is decided.
        """
        self._workers, self._submit = workers, submit
        self._archive, self._events, self._before_end = archive, events, before_end
        self.active: dict[str, Progress] = {}

    @property
    def filming(self) -> list[Progress]:
        """The runs whose board is passing the cameras, oldest first."""
        return [p for p in self.active.values() if p.state is RunState.FILMING]

    def open(self, progress: Progress) -> None:
        """Begin the run of a board that has interrupted the barrier."""
        self.active[progress.run] = progress
        # Workers receive what all jobs of the run need before its first job can reach them.
        self._workers.open_run(progress.opening)
        self._archive.begin(progress)
        self._publish(progress, f"A board of type {progress.order.board_type.name!r} is being filmed.")

    def pulse(self, report: PulseReported) -> None:
        """Record a trigger pulse of a run. During filming, frames are linked only in rows with a recorded pulse."""
        if (progress := self.active.get(report.run)) is not None:
            progress.pulses[report.pulse.index] = report.pulse

    def settle(self, report: FrameSettled) -> None:
        """Record the verdict of a frame, and submit the tasks that have become possible with this frame."""
        progress = self.active.get(report.run)
        if progress is not None and progress.state is RunState.FILMING:
            self._submit_all(progress.settle(report))

    def filmed(self, report: RunFinished) -> list[Progress]:
        """Record that all frames of a run are settled, and submit its remaining tasks."""
        progress = self.active.get(report.run)
        if progress is None or progress.state is not RunState.FILMING:
            return []
        jobs = progress.filmed(report)
        self._publish(progress, f"{report.head.rows} rows were filmed.")
        self._submit_all(jobs)
        return self._conclude_if_complete(progress)

    def give_up(self, progress: Progress, reason: Reason) -> list[Progress]:
        """End a run without a result, with a reason for its verdict."""
        progress.add_fault(reason)
        progress.unstitchable = True
        return self._conclude_if_complete(progress)

    def linked(self, job: LinkJob, reply: Reply, at_s: float) -> list[Progress]:
        """Record in its run that the tasks of a job are done. `at_s` is the time of arrival by time.monotonic()."""
        # A reply may come after its run has ended without a result: it is ignored.
        if (progress := self.active.get(job.run)) is None:
            return []
        progress.add_links(job, reply, at_s)
        return self._conclude_if_complete(progress)

    def concluded(self, job: ConcludeJob, reply: Reply, at_s: float) -> list[Progress]:
        """Add the result in a worker's reply to its run. `at_s` is the time of arrival by time.monotonic()."""
        if (progress := self.active.get(job.run)) is None:
            return []
        progress.add_result(reply, at_s)
        if (check := progress.check_job()) is not None:
            self._submit(check)
        return self._end_in_order(progress)

    def _submit_all(self, jobs: Iterable[LinkJob]) -> None:
        for job in jobs:
            self._submit(job)

    def _conclude_if_complete(self, progress: Progress) -> list[Progress]:
        """Submit the conclude job once all evidence has arrived, or end the run if no result is possible."""
        if progress.state is not RunState.STITCHING:
            return []
        if progress.unstitchable:
            return self._end_in_order(progress)
        if (job := progress.conclude_job()) is not None:
            self._submit(job)
        return []

    def _end_in_order(self, progress: Progress) -> list[Progress]:
        """Mark a run as done, then end each done run before which all runs have ended; return the runs that ended."""
        # Callers use runs/next and expect boards in the order in which they passed.
        progress.done = True
        ended = list(itertools.takewhile(lambda earlier: earlier.done, self.active.values()))
        for earlier in ended:
            self._end(earlier)
        return ended

    def _end(self, progress: Progress) -> None:
        self._before_end(progress)
        if progress.result is not None:
            progress.result = with_faults(progress.result, progress.faults)
        progress.advance(_final_step(progress))
        del self.active[progress.run]
        self._workers.close_run(progress.run)
        self._archive.finish(progress)

    def _publish(self, progress: Progress, message: str) -> None:
        self._events.add("run", message, state=progress.state, run=progress.run, subject=_board(progress))


def _board(progress: Progress) -> dict[str, str]:
    return {"board": progress.order.board_id} if progress.order.board_id else {}


def _final_step(progress: Progress) -> RunStep:
    verdict = conclude(progress).status
    if progress.stitch is None or verdict is Status.FAILED:
        return RunStep.NOT_STITCHED
    return RunStep.STITCHED if verdict is Status.OK else RunStep.STITCHED_WEAKLY


def camera_heads(config: StationConfig) -> tuple[CameraHead, ...]:
    """Return the camera heads of this station's recordings."""
    return tuple(c.head for c in config.cameras)


def early_end_reason(report: RunFinished) -> Reason | None:
    """Return a reason if the pulses of a run ended although the board may not have left; None for a normal end."""
    if report.reason in WHOLE or report.reason == "max-rows":
        return None  # The reason of a run with too many rows comes from `BoardAccount`.
    return Reason(
        code="run-cut-short",
        message=f"After row {report.head.rows - 1} nothing more was filmed: {report.reason}.",
        action="Film the board again if the pictures do not suffice.",
    )


def salvage_recording(progress: Progress, config: StationConfig) -> RunFinished | None:
    """Build the final report of a run from the pulses and frames that were reported so far; None if there is no row.

    The acquisition process has ended and can no longer send this report. Frames that were not reported get the verdict
    MISSING.
    """
    rows = 0
    # Only rows before the first missing pulse are used: later rows have no certain time.
    while rows in progress.pulses:
        rows += 1
    if not rows:
        return None
    keys = [(camera, row) for camera in range(len(config.cameras)) for row in range(rows)]
    frames = tuple(
        progress.frames.get(key) or FrameRecord(camera=key[0], row=key[1], verdict=Verdict.MISSING, cause=CAUSE)
        for key in keys
    )
    # Times are relative to the first pulse and rounded to 1 ns, as the acquisition process does it. So the tasks that
    # were requested while filming remain valid.
    first_s = progress.pulses[0].time_s
    line, plan = progress.order.line or config.line, progress.order.plan
    lights = tuple(progress.pulses[row].light for row in range(rows))
    program = plan.program if plan is not None else ()
    filmed = [expected for row in range(rows) if (expected := row_of(program, row)) is not None]
    head = RecordingHead(
        format="vaoi-recording",
        version=1,
        cameras=camera_heads(config),
        rows=rows,
        trigger_period_s=line.trigger_period_s,
        conveyor_mm_s=line.conveyor_mm_s,
        rotation_deg=config.line.expected_board.rotation_deg or None,
        missing=tuple((f.camera, f.row) for f in frames if f.verdict is Verdict.MISSING),
        trigger_times_s=tuple(round(progress.pulses[row].time_s - first_s, 9) for row in range(rows)),
        belt_mm=None if plan is None or plan.belt is None else row_ways_mm(plan.belt.row_mm, rows),
        exposures_us=tuple(row.lit_us for row in filmed) or None,
        gains=tuple(row.gains for row in filmed) or None,
        lights=lights if any(lights) else None,
    )
    last_s = max((at for key, at in progress.settled_s.items() if key in progress.present), default=progress.barrier_s)
    return RunFinished(progress.run, progress.context.bay, head, frames, last_s, "acquisition lost")
