"""The runs under way: their tasks go to the workers as soon as frames arrive, their ends to the archive."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from functools import partial
from typing import Protocol

from vaoi_station.acquisition.process.messages import FrameSettled, PulseReported, RunFinished
from vaoi_station.model import Status
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.states.schemas import Reason
from vaoi_station.runs.states.tables import RunState, RunStep
from vaoi_station.runs.workers.jobs import Job, LinkJob, OpenRun, Reply


class Workers(Protocol):
    """What a run needs of the pool of workers."""

    def submit(self, job: Job, done: Callable[[Reply], None]) -> None:
        """Have a job done; `done` is called once, in any thread."""

    def open_run(self, opening: OpenRun) -> None:
        """Jobs of a run are about to come."""

    def close_run(self, run: str) -> None:
        """Nothing more of a run will be asked for."""


class RunBook:
    """Lives in the coordinator's thread; answers of the workers come back to it through `post`."""

    def __init__(
        self,
        workers: Workers,
        archive: Archive,
        events: EventLog,
        post: Callable[..., None],
        ended: Callable[[Progress], None],
    ) -> None:
        self._workers, self._archive, self._events = workers, archive, events
        self._post, self._ended = post, ended
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

    def filmed(self, report: RunFinished) -> None:
        """Every frame has its verdict: do what is left, and conclude."""
        progress = self.active.get(report.run)
        if progress is not None and progress.state is RunState.FILMING:
            jobs = progress.filmed(report)
            self._tell(progress, f"{report.head.rows} rows were filmed.")
            self._submit(jobs)
            self._go_on(progress)

    def give_up(self, progress: Progress, reason: Reason) -> None:
        """There can be no result."""
        progress.blame(reason)
        progress.hopeless = True
        self._go_on(progress)

    def _submit(self, jobs: Iterable[LinkJob]) -> None:
        for job in jobs:
            self._workers.submit(job, partial(self._hear_links, job))

    def _hear_links(self, job: LinkJob, answer: Reply) -> None:
        self._post(self._linked, job, answer, time.monotonic())

    def _hear_result(self, run: str, answer: Reply) -> None:
        self._post(self._concluded, run, answer, time.monotonic())

    def _linked(self, job: LinkJob, answer: Reply, now_s: float) -> None:
        if (progress := self.active.get(job.run)) is not None:
            progress.answered(job, answer, now_s)
            self._go_on(progress)

    def _concluded(self, run: str, answer: Reply, now_s: float) -> None:
        if (progress := self.active.get(run)) is not None:
            progress.concluded(answer, now_s)
            self._end_in_order(progress)

    def _go_on(self, progress: Progress) -> None:
        """Conclude if all evidence is there; end without a result if there can be none."""
        if progress.state is not RunState.STITCHING:
            return
        if progress.hopeless:
            self._end_in_order(progress)
        elif (job := progress.conclusion()) is not None:
            self._workers.submit(job, partial(self._hear_result, progress.run))

    def _end_in_order(self, progress: Progress) -> None:
        """Runs end in the order their boards came: one that is done early waits for those before it."""
        progress.done = True
        for earlier in list(self.active.values()):
            if not earlier.done:
                return
            self._end(earlier)

    def _end(self, progress: Progress) -> None:
        progress.step(_last_step(progress))
        del self.active[progress.run]
        self._workers.close_run(progress.run)
        self._archive.finish(progress)
        self._ended(progress)

    def _tell(self, progress: Progress, message: str) -> None:
        self._events.add("run", message, state=progress.state, run=progress.run)


def _last_step(progress: Progress) -> RunStep:
    stitch = progress.without_components
    if stitch is None or stitch.status is Status.FAILED:
        return RunStep.NOT_STITCHED
    sound = stitch.status is Status.OK and not progress.faults
    return RunStep.STITCHED if sound else RunStep.STITCHED_WEAKLY
