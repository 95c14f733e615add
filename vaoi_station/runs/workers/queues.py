"""Jobs that wait for a worker, and which worker is to do which; confined to the pool's lock."""

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

PACE = BackoffPolicy(first_s=0.25, longest_s=30.0, proven_s=30.0)
"""How soon a worker that died is started again."""


@dataclass(eq=False)
class Queued:
    """A job, and how many workers it took with it."""

    job: Job
    deaths: int = 0


@dataclass
class Worker:
    """One process and what is in its hands."""

    index: int
    process: BaseProcess | None = None
    connection: Connection[Any, Any] | None = None
    ready: bool = False
    jobs: deque[Queued] = field(default_factory=deque)
    """In its hands: what it does, and perhaps what it does next."""
    since_s: float = 0.0
    opened: set[str] = field(default_factory=set)
    evidence: dict[str, set[Task]] = field(default_factory=dict)
    """Of each run, the tasks whose evidence it has: found itself, or gathered."""
    restarts: int = 0
    backoff: Backoff = field(default_factory=lambda: Backoff(PACE))
    seen_s: float | None = None
    asked_s: float | None = None
    """When it was asked for a sign of life it has not given yet."""

    @property
    def idle(self) -> bool:
        """There, with nothing to do."""
        return self.ready and not self.jobs

    @property
    def job(self) -> Queued | None:
        """What it does."""
        return self.jobs[0] if self.jobs else None


class JobQueues:
    """One queue per priority."""

    def __init__(self, workers: Sequence[Worker]) -> None:
        self._workers = workers
        self._queues: dict[Priority, deque[Queued]] = {p: deque() for p in Priority}
        self.runs: dict[str, OpenRun] = {}
        """Whose jobs may come."""
        self.concluder = len(workers) - 1
        """The worker that concludes runs, if it can: it has gathered their evidence."""

    def add(self, queued: Queued) -> None:
        """At the end of its queue."""
        self._queues[queued.job.priority].append(queued)

    def put_back(self, queued: Queued) -> None:
        """In front, for its worker has died."""
        self._queues[queued.job.priority].appendleft(queued)

    def forget(self, run: str) -> None:
        """Nothing more of a run will be asked for."""
        self.runs.pop(run, None)
        self.drop(Priority.LINK, run)
        self.drop(Priority.GATHER, run)

    def emptied(self) -> list[Queued]:
        """All that waited."""
        left = [queued for queue in self._queues.values() for queued in queue]
        for queue in self._queues.values():
            queue.clear()
        return left

    def next_link(self, worker: Worker) -> Queued | None:
        """Links of its own for a worker that does some; none where something more urgent waits for whoever is free.

        Only what fits into the pipe: while a worker works it reads nothing, and were we to wait for it while it sends
        an answer, neither would go on. So the run must have been opened there.
        """
        if worker.jobs[0].job.priority is not Priority.LINK or self._queues[Priority.CONCLUDE]:
            return None
        links = self._queues[Priority.LINK]
        mine = next((q for q in links if self._home(q) == worker.index and q.job.run in worker.opened), None)
        if mine is not None:
            links.remove(mine)
        return mine

    def pass_on(self, worker: Worker, job: Job, answer: Reply) -> None:
        """What a worker found is wanted by the one that will conclude the run."""
        if not isinstance(job, LinkJob) or answer.error is not None or job.run not in self.runs:
            return
        worker.evidence.setdefault(job.run, set()).update(job.tasks)
        if worker.index != self.concluder:
            linked = dict(zip(job.tasks, answer.value, strict=True))
            self._queues[Priority.GATHER].append(Queued(GatherJob(job.context, linked)))

    def drop(self, priority: Priority, run: str) -> None:
        """Leave jobs of one kind undone."""
        self._queues[priority] = deque(q for q in self._queues[priority] if q.job.run != run)

    def choose(self, worker: Worker) -> Queued | None:
        """The job that suits an idle worker best, taken out."""
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
        """The worker that has this job's frames prepared: each has a part of the array, side by side.

        Only where two parts meet are frames prepared by both.
        """
        job, opening = queued.job, self.runs.get(queued.job.run)
        if isinstance(job, GatherJob | ConcludeJob):
            return self.concluder
        if job.affinity is None or opening is None:
            return None
        return job.affinity * len(self._workers) // len(opening.setup.cameras)

    def _may_take(self, job: Job, home: int | None, waiting: Counter[int | None]) -> bool:
        """Whether another worker than its own should do a job: its own is away, or has more than it can do next."""
        if home is None:
            return True
        own = self._workers[home]
        if isinstance(job, ConcludeJob):
            return not own.ready or (own.job is not None and own.job.job.priority > Priority.GATHER)
        return not isinstance(job, GatherJob) and (not own.ready or waiting[home] > 1)
