"""What stitches a run: it takes frames as they settle, asks the workers for their links, and answers once.

The coordinator's thread reports pulses and frames. The replies of the workers come in the pool's thread, which requests
the conclusion with the last of them; so neither links nor the conclusion wait for the coordinator.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from vaoi_station.errors import VaoiError
from vaoi_station.model import FrameRecord, Pulse, RecordingHead, Verdict
from vaoi_station.model.recording import motion_time_s
from vaoi_station.runs.states.schemas import TaskTiming
from vaoi_station.runs.workers.jobs import (
    Concluded,
    ConcludeJob,
    Job,
    LinkJob,
    OpenRun,
    PictureJob,
    Reply,
    WorkerLostError,
)
from vaoi_station.stitching.matching.evidence import FrameKey, Task
from vaoi_station.stitching.work import all_tasks, possible_tasks


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


@dataclass(frozen=True)
class Stitched:
    """The answer of a stitcher."""

    result: Concluded | None
    """None if no result is possible; then `errors` say why."""
    errors: tuple[VaoiError, ...] = ()
    timings: tuple[TaskTiming, ...] = ()
    conclude_ms: float = 0.0
    ready_s: float | None = None
    """Time at which the result came, by time.monotonic()."""


class RunStitcher:
    """Has one run stitched. Times in s are host times by time.monotonic()."""

    def __init__(self, opening: OpenRun, barrier_s: float, row_mm: float | None = None) -> None:
        """Take a run; `row_mm` is the distance of the rows on a belt with an encoder, None on one without."""
        self.opening, self.barrier_s, self._row_mm = opening, barrier_s, row_mm
        self.pulses: dict[int, Pulse] = {}
        """Frames are linked while filming only in rows with a reported pulse: others have no time yet."""
        self.frames: dict[FrameKey, FrameRecord] = {}
        self.settled_s: dict[FrameKey, float] = {}
        self._linkable: set[FrameKey] = set()
        self._requested_s: dict[Task, float] = {}
        """Tasks that were given to workers, with the time at which the last of their frames was settled."""
        self._pending: set[Task] = set()
        self._failed: set[Task] = set()
        self._canonical: tuple[Task, ...] = ()
        """The tasks whose evidence the result uses; empty until all frames are settled."""
        self._head: RecordingHead | None = None
        self._errors: list[VaoiError] = []
        self._timings: list[TaskTiming] = []
        self.conclusion: ConcludeJob | None = None
        """The job that concludes the run, once all its tasks are done."""
        self._concluding = False
        # Workers of a test reply within `submit`.
        self._lock = threading.RLock()

    def start(self, workers: Workers, answer: Callable[[Stitched], object]) -> None:
        """Announce the run to the workers; `answer` is called once, in any thread, and must return at once."""
        self._workers, self._answer_to = workers, answer
        workers.open_run(self.opening)

    @property
    def present(self) -> tuple[FrameKey, ...]:
        """Keys (camera, row) of the usable frames, sorted."""
        return tuple(sorted(key for key, frame in self.frames.items() if frame.usable))

    def settle(self, frame: FrameRecord, at_s: float) -> None:
        """Take the verdict of a frame, and request the tasks that it makes possible."""
        key = frame.camera, frame.row
        self.frames[key], self.settled_s[key] = frame, at_s
        if frame.verdict is Verdict.OK and frame.row in self.pulses:
            self._linkable.add(key)
            tasks = possible_tasks(key, self._linkable, self._times_s(), self.opening.setup)
            self._submit(self._jobs_for(frame.camera, tasks))

    def film(self, head: RecordingHead, frames: Iterable[FrameRecord]) -> None:
        """Take the final verdicts of all frames, and request what the result still needs."""
        with self._lock:
            self.frames = {(f.camera, f.row): f for f in frames}
            self._head = head
            self._canonical = self._select_canonical(dict(enumerate(head.motion_times_s().tolist())))
            missing = (task for task in self._canonical if task not in self._requested_s)
            jobs = [job for task in missing for job in self._jobs_for(task.a[0], (task,))]
        self._submit(jobs)
        self._conclude_if_complete()

    def _times_s(self) -> dict[int, float]:
        """Return the time of each row after the first reported pulse, rounded to 1 ns as in the recording's head.

        If the encoder spaces the rows, it is the time in which a belt at its nominal speed would have got there.
        """
        if self._row_mm is not None:
            velocity = self.opening.setup.conveyor_mm_s
            return {row: motion_time_s(round(row * self._row_mm, 6), velocity) for row in self.pulses}
        first_s = self.pulses[min(self.pulses)].time_s
        return {row: round(pulse.time_s - first_s, 9) for row, pulse in self.pulses.items()}

    def _select_canonical(self, times_s: dict[int, float]) -> tuple[Task, ...]:
        # If frames are missing, the requested tasks depend on the order in which frames arrived. Then the tasks are
        # selected anew from all frames, so that the run gives the same result as its recording. A frame that the proof
        # questions was linked while filming, and is not used either.
        whole = len(self._linkable) == len(self.frames) == len(self.opening.setup.cameras) * len(times_s)
        if whole and len(self.present) == len(self.frames) and self._times_s() == times_s:
            return tuple(self._requested_s)
        return all_tasks(self.present, times_s, self.opening.setup)

    def _jobs_for(self, camera: int, tasks: Iterable[Task]) -> list[LinkJob]:
        with self._lock:
            new = tuple(task for task in tasks if task not in self._requested_s)
            for task in new:
                self._requested_s[task] = max(self.settled_s.get(key, self.barrier_s) for key in _frames_of(task))
            self._pending.update(new)
            frames = dict.fromkeys(key for task in new for key in _frames_of(task))
            return [LinkJob(self.opening.context, camera, new, self._slots(frames))] if new else []

    def _submit(self, jobs: Iterable[LinkJob]) -> None:
        for job in jobs:
            self._workers.submit(job, partial(self._linked, job))

    def _linked(self, job: LinkJob, reply: Reply) -> None:
        at_s = time.monotonic()
        with self._lock:
            self._pending.difference_update(job.tasks)
            if reply.error is not None:
                self._failed.update(job.tasks)
                self._errors.append(reply.error)
            else:
                times = zip(job.tasks, reply.value, strict=True)
                self._timings += [self._timing(task, worker_s, at_s) for task, worker_s in times]
        self._conclude_if_complete()

    def _conclude_if_complete(self) -> None:
        with self._lock:
            if self._head is None or self._concluding:
                return
            # A task that fails only loses its evidence. Where workers died, they would die in the conclusion too,
            # which reads the same frames.
            lost = any(isinstance(error, WorkerLostError) for error in self._errors)
            if not lost and not self._pending.isdisjoint(self._canonical):
                return
            self._concluding = True
            tasks = tuple(task for task in self._canonical if task not in self._failed)
            job = self.conclusion = ConcludeJob(self.opening.context, self._head, self._slots(self.present), tasks)
        if lost:
            self._answer(Reply(None, None, 0.0))
        else:
            self._workers.submit(job, self._answer)

    def _answer(self, reply: Reply) -> None:
        errors = (*self._errors, *(() if reply.error is None else (reply.error,)))
        ready_s = None if reply.value is None else time.monotonic()
        self._answer_to(Stitched(reply.value, errors, tuple(self._timings), reply.worker_s * 1e3, ready_s))

    def _timing(self, task: Task, worker_s: float, at_s: float) -> TaskTiming:
        return TaskTiming(
            kind=task.kind,
            camera=task.a[0],
            row=task.a[1],
            other_camera=task.b[0] if task.b else None,
            other_row=task.b[1] if task.b else None,
            ready_s=self._requested_s[task] - self.barrier_s,
            done_s=at_s - self.barrier_s,
            worker_ms=worker_s * 1e3,
        )

    def _slots(self, keys: Iterable[FrameKey]) -> dict[FrameKey, int]:
        return {key: slot for key in keys if (slot := self.frames[key].slot) is not None}


def _frames_of(task: Task) -> list[FrameKey]:
    """Return the keys of this run's frames that a task reads; `b` of a "reference" task is one of another run."""
    return [task.a] if task.b is None or task.kind == "reference" else [task.a, task.b]
