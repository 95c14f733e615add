"""Waiting jobs and the choice of the worker for each; every call needs the pool's lock."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from vaoi_station.backoff import Backoff, BackoffPolicy
from vaoi_station.runs.workers.jobs import ConcludeJob, GatherJob, Job, LinkJob, OpenRun, Priority, Reply
from vaoi_station.stitching.matching.evidence import Task

RESTART_POLICY = BackoffPolicy(first_s=0.25, longest_s=30.0, proven_s=30.0)
"""Pauses before a worker that died is restarted."""


@dataclass(eq=False)
class Queued:
    """A job, and the number of workers that died while they performed it."""

    job: Job
    deaths: int = 0


@dataclass
class Worker:
    """One worker process, the jobs it was given, and the data it holds."""

    index: int
    process: BaseProcess | None = None
    connection: Connection[Any, Any] | None = None
    ready: bool = False
    jobs: deque[Queued] = field(default_factory=deque)
    """Jobs given to it: the one under way, and possibly the next one."""
    since_s: float = 0.0
    """Start of the job under way, or of the process, time.monotonic()."""
    opened: set[str] = field(default_factory=set)
    """Runs whose set-up it has received."""
    evidence: dict[str, set[Task]] = field(default_factory=dict)
    """Tasks whose evidence it holds, by run: its own, and what was gathered from other workers."""
    restarts: int = 0
    backoff: Backoff = field(default_factory=lambda: Backoff(RESTART_POLICY))
    seen_s: float | None = None
    """Time of its latest message; None before the first."""
    pinged_s: float | None = None
    """Time of an unanswered ping; None without one."""

    @property
    def idle(self) -> bool:
        """Whether it is ready and has no job."""
        return self.ready and not self.jobs

    @property
    def job(self) -> Queued | None:
        """The job under way; None without one."""
        return self.jobs[0] if self.jobs else None


class JobQueues:
    """One queue of waiting jobs per priority."""

    def __init__(self, workers: Sequence[Worker]) -> None:
        self._workers = workers
        self._queues: dict[Priority, deque[Queued]] = {p: deque() for p in Priority}
        self.runs: dict[str, OpenRun] = {}
        """Open runs by id."""
        self.concluder = len(workers) - 1
        """Index of the worker that gathers the evidence of all runs, and concludes them if it is free."""

    def add(self, queued: Queued) -> None:
        """Append a job to its queue."""
        self._queues[queued.job.priority].append(queued)

    def put_back(self, queued: Queued) -> None:
        """Put a job at the front of its queue, because its worker has died."""
        self._queues[queued.job.priority].appendleft(queued)

    def forget(self, run: str) -> None:
        """Close a run: drop its waiting link and gather jobs."""
        self.runs.pop(run, None)
        self.drop(Priority.LINK, run)
        self.drop(Priority.GATHER, run)

    def emptied(self) -> list[Queued]:
        """Remove and return all waiting jobs."""
        left = [queued for queue in self._queues.values() for queued in queue]
        for queue in self._queues.values():
            queue.clear()
        return left

    def next_link(self, worker: Worker) -> Queued | None:
        """Take out a second link job for a worker that performs one, so that it does not wait for the pool in between.

        Returns None while a conclusion waits, which goes to the next free worker.
        """
        # A busy worker does not read its pipe. A message larger than the pipe's buffer would block the pool until the
        # worker reads, while the worker may block sending its reply: a deadlock. A link job is small; the set-up of a
        # run (OpenRun) is not, so the run must be open there already.
        if worker.jobs[0].job.priority is not Priority.LINK or self._queues[Priority.CONCLUDE]:
            return None
        links = self._queues[Priority.LINK]
        mine = next((q for q in links if self._home(q) == worker.index and q.job.run in worker.opened), None)
        if mine is not None:
            links.remove(mine)
        return mine

    def share_evidence(self, worker: Worker, job: Job, reply: Reply) -> None:
        """Note whose evidence a worker holds now, and queue it for the worker that will conclude the run."""
        # A reply that arrives after the run was closed must not bring its entry back: nothing would remove it again.
        if not isinstance(job, LinkJob) or reply.error is not None or job.run not in self.runs:
            return
        worker.evidence.setdefault(job.run, set()).update(job.tasks)
        if worker.index != self.concluder:
            linked = dict(zip(job.tasks, reply.value, strict=True))
            self._queues[Priority.GATHER].append(Queued(GatherJob(job.context, linked)))

    def drop(self, priority: Priority, run: str) -> None:
        """Drop the waiting jobs of one priority and run."""
        self._queues[priority] = deque(q for q in self._queues[priority] if q.job.run != run)

    def choose(self, worker: Worker) -> Queued | None:
        """Take out the most urgent job that an idle worker may perform, preferring jobs assigned to it."""
        for queue in self._queues.values():
            homes = [self._home(q) for q in queue]
            waiting = Counter(homes)
            mine = next((q for q, home in zip(queue, homes, strict=True) if home in (None, worker.index)), None)
            others = (q for q, home in zip(queue, homes, strict=True) if self._may_take(q.job, home, waiting))
            chosen = mine or next(others, None)
            if chosen is not None:
                queue.remove(chosen)
                return chosen
        return None

    def _home(self, queued: Queued) -> int | None:
        """Return the index of the worker that has this job's frames prepared; None if any worker will do.

        Each worker serves a block of neighbouring cameras, so that only frames at the border between two blocks are
        prepared twice.
        """
        job, opening = queued.job, self.runs.get(queued.job.run)
        if isinstance(job, GatherJob | ConcludeJob):
            return self.concluder
        if job.affinity is None or opening is None:
            return None
        return job.affinity * len(self._workers) // len(opening.setup.cameras)

    def _may_take(self, job: Job, home: int | None, waiting: Counter[int | None]) -> bool:
        """Whether a worker other than the assigned one may take a job."""
        if home is None:
            return True
        own = self._workers[home]
        if isinstance(job, ConcludeJob):
            # Another worker would first have to receive all evidence. That costs less than to wait for a picture or a
            # check, and more than to wait for a link or gather job.
            return not own.ready or (own.job is not None and own.job.job.priority > Priority.GATHER)
        if isinstance(job, GatherJob):
            return False
        # One waiting job is left to its worker, which prepares its frames only once; a second one would wait too long.
        # A check takes longer than a link, so the next board's first frames go to a free worker at once.
        checking = own.job is not None and own.job.job.priority is Priority.CHECK
        return not own.ready or checking or waiting[home] > 1
