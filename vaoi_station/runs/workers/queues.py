"""Queues of waiting jobs, and the choice of the worker for each job. Every call needs the pool's lock."""

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
"""Pauses before a worker that has died is restarted."""


@dataclass(eq=False)
class Queued:
    """A job, and the number of workers that have died while they performed it."""

    job: Job
    deaths: int = 0


@dataclass
class Worker:
    """One worker: its process, the jobs that were given to it, and the data that it holds. It outlives a restart."""

    index: int
    process: BaseProcess | None = None
    connection: Connection[Any, Any] | None = None
    ready: bool = False
    jobs: deque[Queued] = field(default_factory=deque)
    """Jobs that were given to the worker: the job under way, and possibly the next one."""
    since_s: float = 0.0
    """Time at which the job under way was started, or the process if there was no job, by time.monotonic()."""
    opened: set[str] = field(default_factory=set)
    """Ids of the runs whose set-up was sent to the worker."""
    evidence: dict[str, set[Task]] = field(default_factory=dict)
    """Tasks whose evidence the worker holds, by run: tasks it performed, and tasks gathered from other workers."""
    restarts: int = 0
    backoff: Backoff = field(default_factory=lambda: Backoff(RESTART_POLICY))
    seen_s: float | None = None
    """Time of the worker's latest message; None before the first message."""
    pinged_s: float | None = None
    """Time of a ping that was not answered yet; None if there is none."""

    @property
    def idle(self) -> bool:
        """Whether the worker is ready and has no job."""
        return self.ready and not self.jobs

    @property
    def job(self) -> Queued | None:
        """The job under way; None if the worker has no job."""
        return self.jobs[0] if self.jobs else None


class JobQueues:
    """The waiting jobs, in one queue per priority."""

    def __init__(self, workers: Sequence[Worker]) -> None:
        self._workers = workers
        self._queues: dict[Priority, deque[Queued]] = {p: deque() for p in Priority}
        self.runs: dict[str, OpenRun] = {}
        """Announcements of the open runs, by run id."""
        self.concluder = len(workers) - 1
        """Index of the worker that gathers the evidence of all runs, and concludes them if it is free."""

    def add(self, queued: Queued) -> None:
        """Append a job to its queue."""
        self._queues[queued.job.priority].append(queued)

    def put_back(self, queued: Queued) -> None:
        """Put a job whose worker has died at the front of its queue, unless its run has been closed meanwhile."""
        # Link and gather jobs of a closed run are of no use, and the set-up that a worker needs for them is gone.
        if isinstance(queued.job, LinkJob | GatherJob) and queued.job.run not in self.runs:
            return
        self._queues[queued.job.priority].appendleft(queued)

    def forget(self, run: str) -> None:
        """Drop the waiting link and gather jobs of a closed run."""
        self.runs.pop(run, None)
        self.drop(Priority.LINK, run)
        self.drop(Priority.GATHER, run)

    def emptied(self) -> list[Queued]:
        """Remove all waiting jobs from the queues and return them."""
        left = [queued for queue in self._queues.values() for queued in queue]
        for queue in self._queues.values():
            queue.clear()
        return left

    def next_link(self, worker: Worker) -> Queued | None:
        """Take a second link job out of its queue for a worker that performs a link job.

        With a second job, the worker need not wait for the pool between the two. Return None if no job is suitable, and
        while a conclude job waits, which is to go to the next free worker.
        """
        # A busy worker does not read its pipe. A message larger than the pipe's buffer would block the pool until the
        # worker reads, while the worker may block sending its reply: a deadlock. A link job is small. The set-up of a
        # run (OpenRun) is large, so the worker must have received it already.
        if worker.jobs[0].job.priority is not Priority.LINK or self._queues[Priority.CONCLUDE]:
            return None
        links = self._queues[Priority.LINK]
        mine = next((q for q in links if self._home(q) == worker.index and q.job.run in worker.opened), None)
        if mine is not None:
            links.remove(mine)
        return mine

    def share_evidence(self, worker: Worker, job: Job, reply: Reply) -> None:
        """Record that a worker holds the evidence of its link job, and queue a gather job for the concluding worker."""
        # A reply that arrives after the run was closed must not add an entry for the run: it would never be removed.
        if not isinstance(job, LinkJob) or reply.error is not None or job.run not in self.runs:
            return
        worker.evidence.setdefault(job.run, set()).update(job.tasks)
        if worker.index != self.concluder:
            linked = dict(zip(job.tasks, reply.value, strict=True))
            self._queues[Priority.GATHER].append(Queued(GatherJob(job.context, linked)))

    def drop(self, priority: Priority, run: str) -> None:
        """Drop the waiting jobs of one run and one priority."""
        self._queues[priority] = deque(q for q in self._queues[priority] if q.job.run != run)

    def choose(self, worker: Worker) -> Queued | None:
        """Take the most urgent job that an idle worker may perform out of its queue; None if there is none.

        Within a queue, jobs that are assigned to this worker, or to no worker, come first.
        """
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
        """Return the index of the worker to which a job is assigned; None if any worker may perform it.

        Link jobs are assigned by camera: each worker serves a block of neighbouring cameras. So a frame is prepared by
        one worker, and only frames at the border between two blocks are prepared by two.
        """
        job, opening = queued.job, self.runs.get(queued.job.run)
        if isinstance(job, GatherJob | ConcludeJob):
            return self.concluder
        if job.affinity is None or opening is None:
            return None
        return job.affinity * len(self._workers) // len(opening.setup.cameras)

    def _may_take(self, job: Job, home: int | None, waiting: Counter[int | None]) -> bool:
        """Return whether a worker other than the assigned one may take a job.

        Args:
            job: a waiting job.
            home: index of the worker to which the job is assigned; None if any worker may perform it.
            waiting: number of waiting jobs of the same priority, by the worker to which they are assigned.
        """
        if home is None:
            return True
        own = self._workers[home]
        if isinstance(job, ConcludeJob):
            # Another worker must first receive all evidence. This takes less time than to wait until the assigned
            # worker has finished a picture or a check, but more than to wait for a link or gather job.
            return not own.ready or (own.job is not None and own.job.job.priority > Priority.GATHER)
        if isinstance(job, GatherJob):
            return False
        # A single waiting job is left to the assigned worker, which may have its frames prepared already. If more jobs
        # wait, they would wait too long. A check takes longer than a link job, so the first frames of the next board do
        # not wait for it.
        checking = own.job is not None and own.job.job.priority is Priority.CHECK
        return not own.ready or checking or waiting[home] > 1
