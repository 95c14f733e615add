"""The pool's data about one worker: its process, its jobs, the data that it holds, and whether it is overdue."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing import Pipe
from pathlib import Path

from vaoi_station.backoff import Backoff
from vaoi_station.runs.host.message_pipe import MessagePipe
from vaoi_station.runs.states.run_ids import utc_of_host
from vaoi_station.runs.states.schemas import STARTING, ProcessStatus
from vaoi_station.runs.workers.forking.child_process import ChildProcess
from vaoi_station.runs.workers.forking.fork_server_link import (
    END_S,
    RESTART_POLICY,
    ForkServerLink,
    describe_silence,
)
from vaoi_station.runs.workers.jobs import ConcludeJob, Continue, Job, LinkJob, PictureJob, Priority, SteppedJob
from vaoi_station.stitching.matching.evidence import Task

_log = logging.getLogger(__name__)

OVERDUE_S: Mapping[Priority, float] = {
    Priority.LINK: 1.0,
    Priority.GATHER: 1.0,
    Priority.CONCLUDE: 3.0,
    Priority.SMALL_RENDER: 3.0,
    Priority.RENDER: 3.0,
    Priority.BATCH: 3.0,
    Priority.CHECK: 5.0,
    Priority.IDENTITY: 5.0,
    Priority.OVERVIEW: 5.0,
    Priority.HEIGHTS: 5.0,
}
"""Time after which a job is overdue: other workers take the jobs that wait for its worker, and an idle one repeats it.

This is many times the usual time of a job. A worker that was only slow finishes its job as well; the first reply
counts."""
CODE_S = 0.5
"""Longest wait for the exit code of a worker that has ended, s.

The fork server reports it at once, unless it hangs."""
PING_OVERDUE_S = 1.0
"""Time after which an unanswered ping makes an idle worker overdue, so that no job is given to it."""


@dataclass(eq=False)
class Queued:
    """A job, and the number of workers that have died while they performed it."""

    job: Job
    deaths: int = 0
    done: bool = False
    """Whether the job was answered.

    A second worker that repeats it, or a slow one, may still answer it again."""
    number: int = 0
    """Position of the job in the order in which jobs were queued."""
    began: int | None = None
    """Index of the worker that holds what a paused job has computed so far; None for other jobs."""

    @property
    def continuation(self) -> Continue:
        """The message by which the worker that began a job goes on with it."""
        assert isinstance(self.job, SteppedJob)
        return Continue(self.job.run, self.job.request)

    @property
    def repeatable(self) -> bool:
        """Whether another worker may perform the job while its worker is overdue.

        Gathered evidence is useful only to the worker that gathers it. The evidence of a check exists only in its
        worker.
        """
        if isinstance(self.job, PictureJob):
            return not self.done and self.job.repeatable
        return not self.done and isinstance(self.job, LinkJob | ConcludeJob)

    @property
    def longest_s(self) -> float | None:
        """Longest time for the job; None: the limit of all jobs."""
        return self.job.longest_s if isinstance(self.job, PictureJob) else None


@dataclass
class Worker:
    """One worker: its process, the jobs that were given to it, and the data that it holds. It is kept over restarts."""

    index: int
    process: ChildProcess | None = None
    pipe: MessagePipe | None = None
    """The station's end of the pipe to the process; it exists from the time at which the process is requested."""
    ended_s: float | None = None
    """Time at which the end of the process was noticed, by time.monotonic(); None while it runs."""
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
    overdue: bool = False
    """Whether the job under way, or the reply to a ping, is overdue; see `update`."""
    linked_last: bool = False
    """Whether the last job that was chosen for it is a link."""
    silent_s: float | None = None
    """Time without a reply after which the station has killed the process; None if it has not."""

    @property
    def idle(self) -> bool:
        """Whether the worker is ready and has no job."""
        return self.ready and not self.jobs

    @property
    def job(self) -> Queued | None:
        """The job under way; None if the worker has no job."""
        return self.jobs[0] if self.jobs else None

    def status(self, progress: str) -> ProcessStatus:
        """Return the state of the worker, for `GET station` and the page; `progress` is that of the fork server."""
        return ProcessStatus(
            name=f"worker {self.index}",
            pid=self.process.pid if self.process else None,
            alive=self.process is not None and self.ended_s is None,
            restarts=self.restarts,
            heartbeat_age_s=None if self.seen_s is None else time.monotonic() - self.seen_s,
            doing=str(self.job.job) if self.job else "idle" if self.ready else STARTING,
            progress="" if self.ready else progress,
            next_try=None if self.backoff.due_s is None else utc_of_host(self.backoff.due_s),
        )

    def request_process(self, server: ForkServerLink, ring: Path) -> None:
        """Request a process of the fork server.

        Raises:
            OSError: the fork server has ended or does not read, or there are too many open files.
        """
        self.backoff.start_attempt()
        here, there = Pipe()
        # The process gets a copy of its end. If it were kept open here, the pipe would stay open after its death.
        with there:
            try:
                server.request(self.index, str(ring), there.fileno())
            except OSError:
                here.close()
                raise
        self.pipe, self.since_s = MessagePipe(here), time.monotonic()

    def due_s(self) -> float | None:
        """Return the time at which the worker becomes overdue; None while it starts, or is idle and not pinged."""
        if self.ready and self.jobs:
            return self.since_s + OVERDUE_S[self.jobs[0].job.priority]
        if self.ready and self.pinged_s is not None:
            return self.pinged_s + PING_OVERDUE_S
        return None

    def update(self, now_s: float) -> None:
        """Set `overdue` to whether the worker is overdue at a time by time.monotonic()."""
        due_s = self.due_s()
        self.overdue = due_s is not None and now_s >= due_s

    def kill(self, silent_s: float | None = None) -> None:
        """Kill the worker's process, if there is one; `silent_s` is the limit in s within which it has not replied."""
        if silent_s is not None:
            self.silent_s = silent_s
        if self.process is not None:
            self.process.kill()

    def describe_end(self) -> str:
        """Describe how the process has ended: the end of a sentence that begins with its name."""
        if self.silent_s is not None:
            return describe_silence(self.silent_s)
        code = self.process.exit_code if self.process else None
        return f"ended with code {code}" if code is not None else "ended with an unknown code"

    def awaits_code(self, server: ForkServerLink) -> bool:
        """Record that the process has ended, and return whether its exit code may still arrive."""
        now_s = time.monotonic()
        self.ended_s = self.ended_s or now_s
        return self.process is not None and server.will_report(self.process) and now_s - self.ended_s < CODE_S

    def end(self) -> None:
        """Kill the process if it still runs, wait for its end, close its handles, and forget what it held."""
        process, pipe = self.process, self.pipe
        self.process = self.pipe = self.silent_s = self.ended_s = self.pinged_s = None
        self.ready = False
        self.opened.clear()
        self.evidence.clear()
        if process is not None:
            process.kill()
            if not process.has_ended(END_S):
                _log.error("process %s of worker %d cannot be ended; it is left alone", process.pid, self.index)
            process.close()
        if pipe is not None:
            pipe.close()


def end_all(workers: Sequence[Worker], timeout_s: float) -> None:
    """Wait until the processes of all workers have ended, and kill those that still run after `timeout_s`."""
    deadline_s = time.monotonic() + timeout_s
    for worker in workers:
        if worker.process is not None:
            worker.process.has_ended(deadline_s - time.monotonic())
        worker.end()
