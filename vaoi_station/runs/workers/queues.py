"""Waiting jobs, and which worker gets which. Every call needs the pool's lock.

Every queue has a bound: link jobs are those of the runs in the ring and end with their run; each run has one conclusion
and one check; pictures are limited by `MAX_PICTURES`, parts of batches by the seats of their callers; of codes and of
heights after runs at most one job each waits. Each assigned worker has queues of its own, so that the time for a choice
does not depend on the number of waiting jobs.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from vaoi_station.backoff import Backoff
from vaoi_station.errors import BusyError, StateError, VaoiError
from vaoi_station.runs.host.message_pipe import MessagePipe
from vaoi_station.runs.states.run_ids import utc_of_host
from vaoi_station.runs.states.schemas import STARTING, ProcessStatus
from vaoi_station.runs.workers.fork_server_link import RESTART_POLICY, ChildProcess
from vaoi_station.runs.workers.jobs import (
    EXPLAINABLE_RUNS,
    ConcludeJob,
    ExplainJob,
    Job,
    LinkJob,
    OpenRun,
    PictureJob,
    Priority,
    Reply,
    RunJob,
    SteppedJob,
)

MAX_PICTURES = 64
"""Largest number of waiting single pictures; further requests are refused."""
OVERDUE_S: Mapping[Priority, float] = {
    Priority.LINK: 1.0, Priority.CONCLUDE: 3.0, Priority.RENDER: 3.0, Priority.BATCH: 3.0,
    Priority.CHECK: 5.0, Priority.IDENTITY: 5.0, Priority.OVERVIEW: 5.0, Priority.HEIGHTS: 5.0,
}  # fmt: skip
"""Time after which a job is overdue: other workers take the jobs that wait for its worker, and an idle one repeats it.

This is many times the usual time of a job. A worker that was only slow finishes its job as well; the first reply
counts."""
PING_OVERDUE_S = 1.0
"""Time after which an unanswered ping makes an idle worker overdue, so that no job is given to it."""


@dataclass(eq=False)
class Queued:
    """A job that was submitted, until it is answered."""

    job: Job
    done: Callable[[Reply], object]
    number: int = 0
    """Number that names the job in messages."""
    position: int = 0
    """Position in the order in which jobs were queued; a paused job comes after those that wait already."""
    deaths: int = 0
    """Number of workers that have died while they performed it."""
    answered: bool = False
    """Whether it was answered. A second worker that repeats it, or a slow one, may still answer it again."""
    began: int | None = None
    """Index of the worker that holds what a paused job has computed so far; None for other jobs."""

    @property
    def repeatable(self) -> bool:
        """Whether another worker may perform the job while its worker is overdue."""
        able = self.job.repeatable if isinstance(self.job, PictureJob) else not isinstance(self.job, ExplainJob)
        return able and not self.answered


@dataclass
class Worker:
    """One worker: its process, and the jobs that were given to it. It is kept over restarts."""

    index: int
    process: ChildProcess | None = None
    pipe: MessagePipe | None = None
    """The station's end of the pipe to the process; it exists from the time at which the process is requested."""
    ready: bool = False
    jobs: deque[Queued] = field(default_factory=deque)
    """The job under way, and possibly the next one."""
    opened: set[str] = field(default_factory=set)
    """Ids of the runs whose set-up was sent to the worker."""
    restarts: int = 0
    backoff: Backoff = field(default_factory=lambda: Backoff(RESTART_POLICY))
    since_s: float = 0.0
    """Time at which the job under way was started, or the process if there was no job, by time.monotonic()."""
    seen_s: float | None = None
    """Time of the latest message; None before the first one."""
    pinged_s: float | None = None
    """Time of a ping that was not answered yet; None if there is none."""
    ended_s: float | None = None
    """Time at which the end of the process was noticed; None while it runs."""
    silent_s: float | None = None
    """Time without a reply after which the station has killed the process; None if it has not."""
    overdue: bool = False
    """Whether the job under way, or the reply to a ping, is overdue; see `update`."""

    @property
    def idle(self) -> bool:
        """Whether the worker is ready and has no job."""
        return self.ready and not self.jobs

    @property
    def job(self) -> Job | None:
        """The job under way; None if the worker has no job."""
        return self.jobs[0].job if self.jobs else None

    def status(self, progress: str) -> ProcessStatus:
        """Return the state of the worker, for `GET station` and the page; `progress` is that of the fork server."""
        return ProcessStatus(
            name=f"worker {self.index}",
            pid=self.process.pid if self.process else None,
            alive=self.process is not None and self.ended_s is None,
            restarts=self.restarts,
            heartbeat_age_s=None if self.seen_s is None else time.monotonic() - self.seen_s,
            doing=str(self.job) if self.job else "idle" if self.ready else STARTING,
            progress="" if self.ready else progress,
            next_try=None if self.backoff.due_s is None else utc_of_host(self.backoff.due_s),
        )

    def due_s(self) -> float | None:
        """Return the time at which the worker becomes overdue; None while it starts, or is idle and not pinged."""
        if self.ready and self.jobs:
            return self.since_s + OVERDUE_S[self.jobs[0].job.priority]
        return self.pinged_s + PING_OVERDUE_S if self.ready and self.pinged_s is not None else None

    def update(self, now_s: float) -> None:
        """Set whether the worker is overdue at a time by time.monotonic()."""
        due_s = self.due_s()
        self.overdue = due_s is not None and now_s >= due_s


class JobQueues:
    """The waiting jobs, in one queue per priority and assigned worker."""

    def __init__(self, workers: Sequence[Worker]) -> None:
        self._workers = workers
        self._queues: dict[Priority, defaultdict[int | None, deque[Queued]]] = {p: defaultdict(deque) for p in Priority}
        self._numbers = itertools.count(1)
        self._hastened: Counter[tuple[type[Job], str]] = Counter()
        """Number of callers who wait for the spare-time jobs of a kind and a run."""
        self.runs: dict[str, OpenRun] = {}
        """Announcements of the open runs, by run id."""
        self.owner = len(workers) - 1
        """Index of the worker that owns all runs: it holds their evidence, and concludes them if it is free."""
        self._concluded_by: dict[str, int] = {}

    def waiting(self, priority: Priority) -> int:
        """Return the number of waiting jobs of one priority."""
        return sum(map(len, self._queues[priority].values()))

    def refusal(self, job: Job) -> VaoiError | None:
        """Return why a job is not taken: its run is not open, or too many pictures wait. None if it is taken."""
        if self._is_closed(job):
            return StateError(f"{job} comes after the run was closed.")
        if job.priority is not Priority.RENDER or self.waiting(Priority.RENDER) < MAX_PICTURES:
            return None
        return BusyError(
            f"{MAX_PICTURES} pictures wait for a worker already, which is the limit.",
            action="Request fewer pictures at a time, or request this one again in a moment.",
            code="pictures-busy",
        )

    def add(self, queued: Queued) -> None:
        """Append a job to its queue."""
        queued.number = queued.position = next(self._numbers)
        self._queue_of(queued).append(queued)

    def put_back(self, queued: Queued) -> None:
        """Put a job whose worker has died at the front of its queue, unless its run was closed meanwhile."""
        # The job of a closed run is not needed, and the set-up that a worker needs for it is no longer there.
        if not self._is_closed(queued.job):
            self._queue_of(queued).appendleft(queued)

    def pause(self, queued: Queued, worker: Worker) -> None:
        """Queue a stepped job that goes on in its worker: before younger ones like it, after what waits already."""
        queued.began, queued.position = worker.index, next(self._numbers)
        self._queue_of(queued).appendleft(queued)

    def concluded(self, run: str, worker: Worker) -> None:
        """Remember which worker has concluded a run, for its check; of the last runs, as workers do."""
        self._concluded_by[run] = worker.index
        for former in [*self._concluded_by][:-EXPLAINABLE_RUNS]:
            del self._concluded_by[former]

    def hasten(self, kind: type[PictureJob], run: str, callers: int) -> None:
        """Count callers, fewer if negative, who wait for the spare-time jobs of a kind and a run."""
        self._hastened[kind, run] += callers
        if not self._hastened[kind, run]:
            del self._hastened[kind, run]
        for priority in (Priority.OVERVIEW, Priority.HEIGHTS):
            homes = self._queues[priority]
            for home, queue in [*homes.items()]:
                homes[home] = deque(q for q in queue if self._priority(q.job) is priority)
                for queued in queue:
                    if self._priority(queued.job) is not priority:
                        self._queue_of(queued).append(queued)

    def restart(self, worker: Worker) -> None:
        """Let the paused jobs of a worker that has died begin anew."""
        for homes in self._queues.values():
            for queued in homes.get(worker.index, ()):
                queued.began = None

    def forget(self, run: str) -> None:
        """Drop the waiting jobs of a closed run, except its check and its pictures."""
        self.runs.pop(run, None)
        for priority in (Priority.LINK, Priority.CONCLUDE):
            homes = self._queues[priority]
            for home, queue in homes.items():
                homes[home] = deque(q for q in queue if q.job.run != run)

    def emptied(self) -> list[Queued]:
        """Remove all waiting jobs from the queues and return them."""
        left = [queued for homes in self._queues.values() for queue in homes.values() for queued in queue]
        for homes in self._queues.values():
            homes.clear()
        return left

    def next_link(self, worker: Worker) -> Queued | None:
        """Take a second link out of its queue for a worker that performs one, so that it need not wait for the pool.

        None if no job is suitable, and while a conclusion waits, which goes to the next free worker.
        """
        if worker.jobs[0].job.priority is not Priority.LINK or self.waiting(Priority.CONCLUDE):
            return None
        mine = self._queues[Priority.LINK][worker.index]
        # The set-up of a run is large. A worker without it receives it when it is idle.
        return mine.popleft() if mine and not worker.overdue and mine[0].job.run in worker.opened else None

    def choose(self, worker: Worker) -> Queued | None:
        """Take the most urgent job for an idle worker out of its queue and return it; None if there is none.

        Within a priority, jobs that are assigned to this worker, or to no worker, come first. No picture is begun while
        a check waits, whose worker needs another one to be free of pictures, and no work in spare time while a caller
        waits: this worker would not be free of it when another one, which has begun the caller's job, is to go on with
        it.
        """
        for priority in Priority:
            homes = self._queues[priority]
            if priority > Priority.BATCH and (self.waiting(Priority.RENDER) or self.waiting(Priority.BATCH)):
                return None
            if priority > Priority.CHECK and self._check_is_next():
                return None
            if priority >= Priority.CHECK and not self.may_begin(worker, priority):
                continue
            mine = [homes[home] for home in (None, worker.index) if homes[home]]
            if chosen := min(mine or self._of_others(homes, worker), key=_front, default=None):
                return chosen.popleft()
        return None

    def overdue(self, idle: Worker) -> Queued | None:
        """Return a job of an overdue worker that no other worker has, for an idle one; None if there is none."""
        for queued in (queued for worker in self._workers if worker.overdue for queued in worker.jobs):
            may_begin = not isinstance(queued.job, PictureJob) or self.may_begin(idle, queued.job.priority)
            if queued.repeatable and may_begin and sum(queued in w.jobs for w in self._workers) == 1:
                return queued
        return None

    def may_begin(self, worker: Worker, priority: Priority = Priority.RENDER) -> bool:
        """Return whether a worker may begin a picture or check: another sound one must stay free of them.

        A conclusion that comes meanwhile thus never waits for a picture. While a run is open, its owner makes none:
        another worker would have to read all evidence first. The only sound worker renders too: it would make no
        pictures at all otherwise, and a conclusion waits for at most the one under way. Overviews and heights take
        seconds, so there they wait until no run is open. Parts of batches may take all workers while no run is open:
        they are short, and the conclusion of a board that comes now is seconds away.
        """
        if priority is Priority.BATCH and not self.runs:
            return True
        others = [other for other in self._workers if other is not worker and other.ready and not other.overdue]
        if not others and self.runs and priority >= Priority.OVERVIEW:
            return False
        if others and self.runs and worker.index == self.owner and priority is not Priority.CHECK:
            return False
        # A check follows most conclusions; and other work beside a conclusion delays it, by a third with two workers.
        return not others or any(all(isinstance(q.job, LinkJob) for q in other.jobs) for other in others)

    def _check_is_next(self) -> bool:
        homes = self._queues[Priority.CHECK].items()
        return any(q and h is not None and self._workers[h].ready and not self._workers[h].overdue for h, q in homes)

    def _of_others(self, homes: Mapping[int | None, deque[Queued]], worker: Worker) -> list[deque[Queued]]:
        others = ((home, queue) for home, queue in homes.items() if home not in (None, worker.index) and queue)
        return [queue for home, queue in others if home is not None and self._may_take(queue, home)]

    def _is_closed(self, job: Job) -> bool:
        return isinstance(job, RunJob) and job.run not in self.runs

    def _queue_of(self, queued: Queued) -> deque[Queued]:
        home = self._home(queued.job) if queued.began is None else queued.began
        return self._queues[self._priority(queued.job)][home]

    def _priority(self, job: Job) -> Priority:
        """Return the priority of a job now: while a caller waits for one in spare time, that of single pictures."""
        if job.priority >= Priority.OVERVIEW and (type(job), job.run) in self._hastened:
            return Priority.RENDER
        return job.priority

    def _home(self, job: Job) -> int | None:
        """Return the index of the worker to which a job is assigned; None if any worker may perform it.

        Each worker serves a block of neighbouring cameras. So a frame is prepared by one worker, and only frames at the
        border between two blocks are prepared by two.
        """
        match job:
            case ConcludeJob():
                return self.owner
            case ExplainJob():
                return self._concluded_by.get(job.run, self.owner)
            case SteppedJob():
                # It goes on between the jobs of the next board, of which the owner takes no pictures.
                return max(self.owner - 1, 0)
            case LinkJob():
                return job.camera * len(self._workers) // len(self.runs[job.run].setup.cameras)
        return None

    def _may_take(self, queue: deque[Queued], home: int) -> bool:
        """Return whether a worker other than the assigned one, `home`, may take the first job of its queue."""
        job, own = queue[0].job, self._workers[home]
        away = not own.ready or own.overdue
        # Pictures, checks and heights take longer than a link, up to seconds: no frame of the next board waits for
        # them, least of all its last one.
        longer = own.job is not None and own.job.priority > Priority.LINK
        match job:
            case ConcludeJob():
                # Another worker must read all evidence first: that is shorter than a picture or a check, but not than
                # a link.
                return away or longer
            case ExplainJob():
                return False
            case SteppedJob():
                return not own.ready
        # A single waiting job is left to the assigned worker, which may have its frames prepared already. If more jobs
        # wait, the wait would be too long.
        return away or longer or len(queue) > 1


def _front(queue: deque[Queued]) -> int:
    return queue[0].position
