"""The runs under way: their tasks go to the workers as soon as frames arrive, their ends to the archive."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Protocol

from vaoi_station.acquisition.process.messages import FrameSettled, PulseReported, RunFinished
from vaoi_station.model import Status
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.states.schemas import Reason
from vaoi_station.runs.states.tables import RunState, RunStep
from vaoi_station.runs.workers.jobs import ConcludeJob, Job, LinkJob, OpenRun, Reply


class Workers(Protocol):
    """What a run needs of the pool of workers."""

    def submit(self, job: Job) -> None:
        """Have a job done; its answer comes as an event."""

    def open_run(self, opening: OpenRun) -> None:
        """Jobs of a run are about to come."""

    def close_run(self, run: str) -> None:
        """Nothing more of a run will be asked for."""


class RunBook:
    """Confined to the coordinator's thread. Methods that may end runs return those that have ended, in their order."""

    def __init__(self, workers: Workers, archive: Archive, events: EventLog) -> None:
        self._workers, self._archive, self._events = workers, archive, events
        self.active: dict[str, Progress] = {}

    @property
    def filming(self) -> list[Progress]:
        """Runs whose board is passing, oldest first."""
        return [p for p in self.active.values() if p.state is RunState.FILMING]

    def open(self, progress: Progress) -> None:
        """A board has interrupted the barrier."""
        self.active[progress.run] = progress
        self._workers.open_run(progress.opening)
        self._archive.begin(progress)
        self._tell(progress, f"A board of type {progress.order.board_type.name!r} is being filmed.")

    def pulse(self, report: PulseReported) -> None:
        """A row has been fired."""
        if (progress := self.active.get(report.run)) is not None:
            progress.pulses[report.pulse.index] = report.pulse

    def settle(self, report: FrameSettled) -> None:
        """A frame has its verdict: link it to its neighbours."""
        progress = self.active.get(report.run)
        if progress is not None and progress.state is RunState.FILMING:
            self._submit(progress.settle(report))

    def filmed(self, report: RunFinished) -> list[Progress]:
        """Every frame has its verdict: do what is left, and conclude."""
        progress = self.active.get(report.run)
        if progress is None or progress.state is not RunState.FILMING:
            return []
        jobs = progress.filmed(report)
        self._tell(progress, f"{report.head.rows} rows were filmed.")
        self._submit(jobs)
        return self._go_on(progress)

    def give_up(self, progress: Progress, reason: Reason) -> list[Progress]:
        """There can be no result."""
        progress.blame(reason)
        progress.hopeless = True
        return self._go_on(progress)

    def linked(self, job: LinkJob, answer: Reply, now_s: float) -> list[Progress]:
        """Take the evidence that a worker has found."""
        if (progress := self.active.get(job.run)) is None:
            return []
        progress.answered(job, answer, now_s)
        return self._go_on(progress)

    def concluded(self, job: ConcludeJob, answer: Reply, now_s: float) -> list[Progress]:
        """Take the result of a run."""
        if (progress := self.active.get(job.run)) is None:
            return []
        progress.concluded(answer, now_s)
        return self._end_in_order(progress)

    def _submit(self, jobs: Iterable[LinkJob]) -> None:
        for job in jobs:
            self._workers.submit(job)

    def _go_on(self, progress: Progress) -> list[Progress]:
        """Conclude if all evidence is there; end without a result if there can be none."""
        if progress.state is not RunState.STITCHING:
            return []
        if progress.hopeless:
            return self._end_in_order(progress)
        if (job := progress.conclusion()) is not None:
            self._workers.submit(job)
        return []

    def _end_in_order(self, progress: Progress) -> list[Progress]:
        """Runs end in the order their boards came: one that is done early waits for those before it."""
        progress.done = True
        ended = list(itertools.takewhile(lambda earlier: earlier.done, self.active.values()))
        for earlier in ended:
            self._end(earlier)
        return ended

    def _end(self, progress: Progress) -> None:
        progress.step(_last_step(progress))
        del self.active[progress.run]
        self._workers.close_run(progress.run)
        self._archive.finish(progress)

    def _tell(self, progress: Progress, message: str) -> None:
        self._events.add("run", message, state=progress.state, run=progress.run)


def _last_step(progress: Progress) -> RunStep:
    stitch = progress.without_components
    if stitch is None or stitch.status is Status.FAILED:
        return RunStep.NOT_STITCHED
    sound = stitch.status is Status.OK and not progress.faults
    return RunStep.STITCHED if sound else RunStep.STITCHED_WEAKLY
