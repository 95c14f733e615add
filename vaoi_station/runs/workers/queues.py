"""Queues of waiting jobs, and the choice of the worker for each job. Every call needs the pool's lock.

Every queue has a bound. Link and gather jobs are at most those of the runs in the ring, and end with their run; each
run has one conclude job; pictures are limited by `MAX_PICTURES`, parts of batches by the seats of their callers; checks
are parts of conclude jobs and never wait; of codes and of heights after runs at most one job each waits. There is a
separate queue for each assigned worker, so that the time for a choice does not depend on the number of waiting jobs.
"""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict, deque
from collections.abc import Iterator, Sequence

from vaoi_station.errors import BusyError
from vaoi_station.runs.workers.jobs import (
    ConcludeJob,
    GatherJob,
    Job,
    LinkJob,
    OpenRun,
    PictureJob,
    Priority,
    Reply,
    SteppedJob,
)
from vaoi_station.runs.workers.worker import Queued, Worker

MAX_PICTURES = 64
"""Largest number of waiting render jobs. The station renders only a few at a time; further requests are refused."""
_TURN_OF_PICTURES = sorted(Priority, key=lambda p: 0.5 if p is Priority.SMALL_RENDER else p)
"""Order of priorities for a worker that has just made a link."""
_CALLERS = Priority.SMALL_RENDER, Priority.RENDER, Priority.BATCH
"""Priorities of what callers wait for; those after them are of work in spare time."""


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
        self.concluder = len(workers) - 1
        """Index of the worker that gathers the evidence of all runs, and concludes them if it is free."""

    def waiting(self, priority: Priority) -> int:
        """Return the number of waiting jobs of one priority."""
        return sum(len(queue) for queue in self._queues[priority].values())

    def refusal(self, job: Job) -> BusyError | None:
        """Return why a job is not taken: too many pictures wait. None if it is taken."""
        single = (Priority.SMALL_RENDER, Priority.RENDER)
        if job.priority not in single or sum(map(self.waiting, single)) < MAX_PICTURES:
            return None
        return BusyError(
            f"{MAX_PICTURES} pictures wait for a worker already, which is the limit.",
            action="Request fewer pictures at a time, or request this one again in a moment.",
            code="pictures-busy",
        )

    def add(self, queued: Queued) -> bool:
        """Append a job to its queue. Return False if the job is of a run that is not open."""
        if self._is_closed(queued.job):
            return False
        queued.number = next(self._numbers)
        self._queue_of(queued).append(queued)
        return True

    def put_back(self, queued: Queued) -> None:
        """Put a job whose worker has died back at the front of its queue, unless the job's run was closed meanwhile."""
        # The job of a closed run is not needed, and the set-up that a worker needs for it is no longer there.
        if not self._is_closed(queued.job):
            self._queue_of(queued).appendleft(queued)

    def pause(self, queued: Queued, worker: Worker) -> None:
        """Queue a stepped job that is to go on in its worker: before younger ones like it, after what waits already."""
        queued.began, queued.number = worker.index, next(self._numbers)
        self._queue_of(queued).appendleft(queued)

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
        """Drop the waiting jobs of a closed run, except its pictures."""
        self.runs.pop(run, None)
        for priority in (Priority.LINK, Priority.GATHER, Priority.CONCLUDE):
            self.drop(priority, run)

    def emptied(self) -> list[Queued]:
        """Remove all waiting jobs from the queues and return them."""
        left = [queued for homes in self._queues.values() for queue in homes.values() for queued in queue]
        for homes in self._queues.values():
            homes.clear()
        return left

    def next_link(self, worker: Worker) -> Queued | None:
        """Take a second link job out of its queue for a worker that performs a link job.

        With a second job, the worker need not wait for the pool between the two. Return None if no job is suitable, and
        while a conclude job or a small picture waits, which is to go to the next free worker.
        """
        sooner = self.waiting(Priority.CONCLUDE) or self.waiting(Priority.SMALL_RENDER)
        if worker.jobs[0].job.priority is not Priority.LINK or sooner:
            return None
        mine = self._queues[Priority.LINK][worker.index]
        # The set-up of a run is large. A worker without it receives it when it is idle.
        return mine.popleft() if mine and not worker.overdue and mine[0].job.run in worker.opened else None

    def share_evidence(self, worker: Worker, job: Job, reply: Reply) -> None:
        """Record that a worker holds the evidence of its link job, and queue a gather job for the concluding worker.

        If that worker could not take it over, the conclude job brings it along.
        """
        if isinstance(job, GatherJob) and reply.error is not None:
            worker.evidence.get(job.run, set()).difference_update(job.linked)
        # A reply that arrives after the run was closed must not add an entry for the run, which would never be removed.
        if not isinstance(job, LinkJob) or reply.error is not None or job.run not in self.runs:
            return
        worker.evidence.setdefault(job.run, set()).update(job.tasks)
        if worker.index != self.concluder:
            linked = dict(zip(job.tasks, reply.value, strict=True))
            self.add(Queued(GatherJob(job.context, linked)))

    def drop(self, priority: Priority, run: str) -> None:
        """Drop the waiting jobs of one run and one priority."""
        homes = self._queues[priority]
        for home, queue in homes.items():
            homes[home] = deque(q for q in queue if q.job.run != run)

    def choose(self, worker: Worker) -> Queued | None:
        """Take the most urgent job for an idle worker out of its queue and return it; None if there is none.

        Within a priority, jobs that are assigned to this worker, or to no worker, come first. After a link, a small
        picture comes before the next one: the links of a row, which arrive together, would delay it by tens of
        milliseconds, while it delays them by no more than another link. One worker, the one that concludes, keeps to
        links, so that many callers cannot hold up a fast line. Work in spare time is not begun while a caller waits:
        this worker would not be free of it when another one, which has begun the caller's job, is to go on with it.
        """
        has_turn = worker.linked_last and (worker.index != self.concluder or len(self._workers) == 1)
        for priority in _TURN_OF_PICTURES if has_turn else Priority:
            homes = self._queues[priority]
            if priority > Priority.CHECK and any(map(self.waiting, _CALLERS)):
                return None
            if priority >= Priority.RENDER and not self.may_render(worker, priority):
                continue
            mine = min((homes[h] for h in (None, worker.index) if homes[h]), key=_front, default=None)
            chosen = mine or min(self._of_others(homes, worker), key=_front, default=None)
            if chosen:
                worker.linked_last = priority is Priority.LINK
                return chosen.popleft()
        return None

    def overdue(self, idle: Worker) -> Queued | None:
        """Return a job of an overdue worker that no other worker has, for an idle one; None if there is none."""
        candidates = (
            q
            for worker in self._workers
            if worker.overdue
            for q in worker.jobs
            if q.repeatable and (not isinstance(q.job, PictureJob) or self.may_render(idle, q.job.priority))
        )
        return next((q for q in candidates if sum(q in w.jobs for w in self._workers) == 1), None)

    def may_render(self, worker: Worker, priority: Priority = Priority.RENDER) -> bool:
        """Return whether a worker may begin a picture: another sound one must stay free of pictures and checks.

        A conclusion that comes meanwhile thus never waits for a picture. While a run is open, the worker that gathers
        its evidence stays free: another one would have to receive all of it first. The only sound worker renders too:
        it would make no pictures at all otherwise, and a conclusion waits for at most the one under way. Overviews
        and heights take seconds, so there they wait until no run is open. Small pictures are no longer than links.
        Parts of batches may take all workers while no run is open: they are short, and the conclusion of a board that
        comes now is seconds away.
        """
        if priority is Priority.SMALL_RENDER or (priority is Priority.BATCH and not self.runs):
            return True
        others = [other for other in self._workers if other is not worker and other.ready and not other.overdue]
        if not others and self.runs and priority >= Priority.OVERVIEW:
            return False
        if others and self.runs and worker.index == self.concluder:
            return False
        return not others or any(not _with_picture_or_check(other) for other in others)

    def _of_others(self, homes: defaultdict[int | None, deque[Queued]], worker: Worker) -> Iterator[deque[Queued]]:
        """Yield the queues of other workers from which a worker may take a job."""
        for home, queue in homes.items():
            if home is not None and home != worker.index and queue and self._may_take(queue, home):
                yield queue

    def _is_closed(self, job: Job) -> bool:
        return isinstance(job, LinkJob | GatherJob | ConcludeJob) and job.run not in self.runs

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

        Link jobs are assigned by camera: each worker serves a block of neighbouring cameras. So a frame is prepared by
        one worker, and only frames at the border between two blocks are prepared by two.
        """
        opening = self.runs.get(job.run)
        if isinstance(job, GatherJob | ConcludeJob):
            return self.concluder
        if isinstance(job, SteppedJob):
            # It goes on between the jobs of the next board, of which the concluding worker takes no pictures.
            return max(self.concluder - 1, 0)
        if job.affinity is None or opening is None:
            return None
        return job.affinity * len(self._workers) // len(opening.setup.cameras)

    def _may_take(self, queue: deque[Queued], home: int) -> bool:
        """Return whether a worker other than the assigned one may take the first job of a queue.

        Args:
            queue: the waiting jobs that are assigned to the worker `home`, at least one.
            home: index of that worker.
        """
        job, own = queue[0].job, self._workers[home]
        away = not own.ready or own.overdue
        if isinstance(job, ConcludeJob):
            # Another worker must first receive all evidence. This takes less time than waiting until the assigned
            # worker has finished a picture or a check, but more than waiting for a link or gather job.
            return away or (own.job is not None and own.job.job.priority > Priority.SMALL_RENDER)
        if isinstance(job, GatherJob):
            return False
        if isinstance(job, SteppedJob):
            return not own.ready
        # A single waiting job is left to the assigned worker, which may have its frames prepared already. If more jobs
        # wait, the wait would be too long. Pictures that are not small, checks and heights take longer than a link job,
        # up to seconds: no frame of the next board waits for them, least of all its last one.
        longer = own.job is not None and own.job.job.priority > Priority.SMALL_RENDER
        return away or longer or len(queue) > 1


def _with_picture_or_check(worker: Worker) -> bool:
    """Return whether a worker renders a picture, or checks the calibration now or right after its conclusion."""
    jobs = (queued.job for queued in worker.jobs)
    return any(j.check is not None if isinstance(j, ConcludeJob) else j.priority > Priority.SMALL_RENDER for j in jobs)


def _front(queue: deque[Queued]) -> int:
    return queue[0].number
