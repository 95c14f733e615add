"""Runs that have not ended. Their tasks go to the workers as frames arrive. Their results go to the archive."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from typing import Protocol

from vaoi_station.acquisition.process.messages import FrameSettled, PulseReported, RunFinished
from vaoi_station.model import Status
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.states.schemas import Reason
from vaoi_station.runs.states.tables import RunState, RunStep
from vaoi_station.runs.workers.jobs import ConcludeJob, Job, LinkJob, OpenRun, PictureJob, Reply


class Workers(Protocol):
    """The methods of the worker pool that the coordinator calls."""

    def submit(self, job: Job) -> None:
        """Queue a job for a worker. Its reply is reported by `WorkerEvents.worker_reply`."""

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
        archive: Archive,
        events: EventLog,
        before_end: Callable[[Progress], None] = lambda _progress: None,
    ) -> None:
        """Begin without runs; `before_end` is called with each run before its final state is decided."""
        self._workers, self._archive, self._events, self._before_end = workers, archive, events, before_end
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
            self._submit(progress.settle(report))

    def filmed(self, report: RunFinished) -> list[Progress]:
        """Record that all frames of a run are settled, and submit its remaining tasks."""
        progress = self.active.get(report.run)
        if progress is None or progress.state is not RunState.FILMING:
            return []
        jobs = progress.filmed(report)
        self._publish(progress, f"{report.head.rows} rows were filmed.")
        self._submit(jobs)
        return self._conclude_if_complete(progress)

    def give_up(self, progress: Progress, reason: Reason) -> list[Progress]:
        """End a run without a result, with a reason for its verdict."""
        progress.add_fault(reason)
        progress.unstitchable = True
        return self._conclude_if_complete(progress)

    def linked(self, job: LinkJob, reply: Reply, at_s: float) -> list[Progress]:
        """Add the evidence in a worker's reply to its run. `at_s` is the time of arrival by time.monotonic()."""
        # A reply may come after its run has ended without a result: it is ignored.
        if (progress := self.active.get(job.run)) is None:
            return []
        progress.add_evidence(job, reply, at_s)
        return self._conclude_if_complete(progress)

    def concluded(self, job: ConcludeJob, reply: Reply, at_s: float) -> list[Progress]:
        """Add the result in a worker's reply to its run. `at_s` is the time of arrival by time.monotonic()."""
        if (progress := self.active.get(job.run)) is None:
            return []
        progress.add_result(reply, at_s)
        return self._end_in_order(progress)

    def _submit(self, jobs: Iterable[LinkJob]) -> None:
        for job in jobs:
            self._workers.submit(job)

    def _conclude_if_complete(self, progress: Progress) -> list[Progress]:
        """Submit the conclude job once all evidence has arrived, or end the run if no result is possible."""
        if progress.state is not RunState.STITCHING:
            return []
        if progress.unstitchable:
            return self._end_in_order(progress)
        if (job := progress.conclude_job()) is not None:
            self._workers.submit(job)
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
        progress.weaken_result()
        progress.advance(_final_step(progress))
        del self.active[progress.run]
        self._workers.close_run(progress.run)
        self._archive.finish(progress)

    def _publish(self, progress: Progress, message: str) -> None:
        self._events.add("run", message, state=progress.state, run=progress.run, subject=_board(progress))


def _board(progress: Progress) -> dict[str, str]:
    return {"board": progress.order.board_id} if progress.order.board_id else {}


def _final_step(progress: Progress) -> RunStep:
    if progress.stitch is None or progress.verdict is Status.FAILED:
        return RunStep.NOT_STITCHED
    return RunStep.STITCHED if progress.verdict is Status.OK else RunStep.STITCHED_WEAKLY
