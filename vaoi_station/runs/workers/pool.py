"""The worker pool: it gives jobs to worker processes, and restarts processes that die or hang.

Jobs wait in the pool, not in the pipes to the workers. A worker has one job at a time. A worker that performs a link
job may get a second link job, so that it need not wait for the pool in between. The pool detects the end of a worker at
once by the pidfd of its process. The worker's jobs then go to another worker, and the process is restarted. If
`MAX_ATTEMPTS` workers died during a job, the job is given up with an error. A job that takes much longer than usual
(`worker.OVERDUE_S`) is repeated by an idle worker. The first worker is killed once it is certain that it hangs.

No call waits for a worker: a worker that hangs, or is stopped in the middle of an answer, blocks no thread of the
station.
"""

from __future__ import annotations

import atexit
import logging
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vaoi_station.errors import InternalError, StateError, VaoiError
from vaoi_station.runs.host.message_pipe import PipeEndedError, wait_for
from vaoi_station.runs.states.schemas import ProcessStatus
from vaoi_station.runs.workers.forking.child_process import ChildProcess
from vaoi_station.runs.workers.forking.fork_server_link import ForkServerLink
from vaoi_station.runs.workers.jobs import (
    CheckJob,
    CloseRun,
    ConcludeJob,
    GatherJob,
    Job,
    LinkJob,
    OpenRun,
    Paused,
    PictureJob,
    Ping,
    Priority,
    Reply,
    WorkerReady,
    check_after,
)
from vaoi_station.runs.workers.queues import JobQueues
from vaoi_station.runs.workers.worker import Queued, Worker, end_all
from vaoi_station.runs.workers.worker_events import WorkerEvents
from vaoi_station.supervised_thread import SupervisedThread

_log = logging.getLogger(__name__)

JOB_LIMIT_S = 30.0
"""Longest time for one job. After this time, the worker counts as hung and is killed."""
REPEATED_LIMIT_S = 5.0
"""Longest time for a job that another worker has finished meanwhile, s.

After it, the slower worker counts as hung."""
PING_INTERVAL_S = 1.0
"""Time without a message after which an idle worker is pinged."""
CHECK_PERIOD_S = 0.5
"""Longest time between two checks of the workers' liveness."""
STOP_S = 10.0
"""Longest wait for the pool's thread to end."""
MAX_ATTEMPTS = 2
"""Largest number of attempts at a job whose worker dies: a job that has killed two workers would kill a third too."""


class WorkerPool:
    """The worker processes of the station. Its methods may be called from any thread.

    It reports to the `WorkerEvents` given at the start, mostly in its own thread.
    """

    def __init__(self, count: int, ring_path: Path) -> None:
        self._ring_path = ring_path
        self._events: WorkerEvents | None = None
        self._workers = [Worker(k) for k in range(count)]
        self._queues = JobQueues(self._workers)
        self._lock = threading.RLock()
        self.fork_server = ForkServerLink(self._report_end)
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._stopping = False
        self.thread = SupervisedThread(self._run, "workers")

    def start(self, events: WorkerEvents) -> None:
        """Start the workers, and report to `events`. Jobs may be submitted before the workers are ready."""
        self._events = events
        # Workers ignore SIGTERM and SIGINT. Without this exit handler, they would survive a station that exits by an
        # exception.
        atexit.register(self.stop, 0.0)
        self.thread.start()

    def all_ready(self) -> bool:
        """Return whether every worker has finished its warm-up."""
        with self._lock:
            return all(w.ready for w in self._workers)

    def warm(self) -> bool:
        """Return whether boards may be filmed: at least one worker is ready, and each other one is ready or has failed.

        A worker that ends again and again must not prevent the station from filming with the others.
        """
        with self._lock:
            return any(w.ready for w in self._workers) and all(w.ready or w.restarts for w in self._workers)

    def submit(self, job: Job) -> None:
        """Queue a job; its reply is reported by `WorkerEvents.worker_reply`. A job of a closed run is refused."""
        with self._lock:
            refusal = self._refusal(job)
            if refusal is None and self._queues.add(Queued(job)):
                self._dispatch()
                return
        self._report(job, Reply.refused(refusal or StateError(f"{job} comes after the run was closed.")))

    def _refusal(self, job: Job) -> VaoiError | None:
        if self._stopping:
            return StateError("The station is stopping; its workers take no more jobs.")
        return self._queues.refusal(job)

    def open_run(self, opening: OpenRun) -> None:
        """Announce a run to the pool, before its first job is submitted."""
        with self._lock:
            self._queues.runs[opening.context.run] = opening

    def close_run(self, run: str) -> None:
        """Close a run: drop its waiting link and gather jobs, and make the workers discard what they hold for it."""
        with self._lock:
            self._queues.forget(run)
            for worker in self._workers:
                worker.evidence.pop(run, None)
                if run in worker.opened:
                    worker.opened.discard(run)
                    self._send(worker, CloseRun(run))

    @contextmanager
    def hastened(self, kind: type[PictureJob], run: str) -> Iterator[None]:
        """Within a `with` block, do spare-time jobs of a kind and a run as if a caller had submitted them."""
        with self._lock:
            self._queues.hasten(kind, run, 1)
        try:
            yield
        finally:
            with self._lock:
                self._queues.hasten(kind, run, -1)

    def status(self) -> tuple[ProcessStatus, ...]:
        """Return the state of every worker."""
        with self._lock:
            return tuple(worker.status(self.fork_server.progress) for worker in self._workers)

    def stop(self, timeout_s: float = 5.0) -> None:
        """End all worker processes, and report an error for every unfinished job. A second call does nothing.

        Workers that have not ended after `timeout_s` are killed.
        """
        with self._lock:
            if self._stopping:
                return
            self._stopping = True
        self.thread.expect_end()
        atexit.unregister(self.stop)
        os.eventfd_write(self._wake, 1)
        if self.thread.ident is not None:
            self.thread.join(STOP_S)
        # All workers are asked to end before the first one is awaited, so that they end in parallel.
        for worker in self._workers:
            self._send(worker, None)
        end_all(self._workers, timeout_s)
        self.fork_server.stop()
        for queued in self._abandoned():
            self._report(queued.job, Reply.refused(StateError("The station was stopped before this was done.")))
        os.close(self._wake)

    def _run(self) -> None:
        """Start workers, receive their messages, and reap workers that have died, until the pool is stopped."""
        while not self._stopping:
            self.thread.beat()
            for worker in self._absent():
                if not worker.backoff.remaining_s():
                    self._start_worker(worker)
            running = [w for w in self._workers if w.process is not None and w.ended_s is None]
            pipes = {w.pipe.fileno(): w for w in running if w.pipe is not None}
            ends = (w.process.fileno() for w in running if w.process is not None)
            others = [self._wake, *ends, *self.fork_server.descriptors()]
            ready = wait_for([w.pipe for w in running if w.pipe is not None], others, self._pause_s())
            if self._wake in ready:
                os.eventfd_read(self._wake)
            for descriptor in ready & pipes.keys():
                self._receive(pipes[descriptor])
            for index, outcome in self.fork_server.outcomes():
                self._complete_start(self._workers[index], outcome)
            for worker in self._workers:
                self._supervise(worker)
            with self._lock:
                self._dispatch()

    def _absent(self) -> list[Worker]:
        """Return the workers that have neither a process nor the request for one, if the fork server can fork."""
        return [w for w in self._workers if w.pipe is None] if self.fork_server.ready else []

    def _pause_s(self) -> float:
        """Return the time until the next liveness check, restart or overdue job, s."""
        now_s = time.monotonic()
        restarts_s = [self.fork_server.pause_s(), *(w.backoff.remaining_s() for w in self._absent())]
        with self._lock:
            due_s = [due_s - now_s for w in self._workers if not w.overdue and (due_s := w.due_s()) is not None]
        return max(min([CHECK_PERIOD_S, *restarts_s, *due_s]), 0.0)

    def _start_worker(self, worker: Worker) -> None:
        try:
            with self._lock:
                worker.request_process(self.fork_server, self._ring_path)
        except OSError as fault:
            self._complete_start(worker, str(fault))

    def _complete_start(self, worker: Worker, outcome: ChildProcess | str) -> None:
        """Take over the process of a worker, or report why it was not started."""
        if isinstance(outcome, ChildProcess):
            with self._lock:
                worker.process = outcome
            return
        # There may be too little memory, or too many processes or files. This may pass.
        worker.end()
        worker.backoff.record_failure()
        self._report_end(f"Worker {worker.index} could not be started ({outcome}); it is tried again.")

    def _receive(self, worker: Worker) -> None:
        """Handle the messages that have arrived from a worker, and send messages that its pipe had no room for."""
        assert worker.pipe is not None
        worker.pipe.flush()
        try:
            messages = worker.pipe.receive()
        except PipeEndedError:
            # A worker without its pipe is useless. After it was killed, `_supervise` reaps it.
            worker.kill()
            return
        for message in messages:
            self._handle(worker, message)

    def _handle(self, worker: Worker, message: object) -> None:
        """Handle one message of a worker: that it is ready, or the reply to a job."""
        worker.seen_s, worker.pinged_s = time.monotonic(), None
        queued, complete, first = None, False, False
        with self._lock:
            if isinstance(message, Reply) and worker.jobs:
                queued, worker.since_s = worker.jobs.popleft(), time.monotonic()
                if isinstance(message.value, Paused):
                    self._queues.pause(queued, worker)
                    return
                # A job that was repeated has two replies. The first one counts.
                first, queued.done = not queued.done, True
                if first:
                    self._queues.share_evidence(worker, queued.job, message)
                if (check := check_after(queued.job, message)) is not None:
                    # The worker performs the check already. It is entered as the job under way, so that other jobs go
                    # to free workers until the check's reply, and JOB_LIMIT_S limits its time.
                    worker.jobs.appendleft(Queued(check, done=not first))
            # The first WorkerReady ends the start; later ones are replies to pings.
            if isinstance(message, WorkerReady) and not worker.ready:
                worker.ready = True
                worker.backoff.record_success()
                complete = self.all_ready()
            self._dispatch()
        # Reports are made outside the lock: a receiver may call back into the pool.
        if complete and self._events is not None:
            self._events.workers_ready()
        if isinstance(message, Reply) and queued is not None and first:
            self._report(queued.job, message)

    def _report(self, job: Job, reply: Reply) -> None:
        """Report the outcome of a job. Gather jobs are not reported, because only the pool submits them."""
        if self._events is not None and not isinstance(job, GatherJob):
            self._events.worker_reply(job, reply)

    def _supervise(self, worker: Worker) -> None:
        """Reap a worker that has died, and kill a worker that hangs."""
        if worker.process is None or worker.pipe is None:
            return
        if not worker.process.has_ended():
            self._check_liveness(worker)
        elif not worker.awaits_code(self.fork_server):
            # The worker may have sent a reply before it died. A finished job must not be repeated.
            self._receive(worker)
            self._reap(worker)

    def _check_liveness(self, worker: Worker) -> None:
        """Ping an idle worker, and kill a worker that exceeds its time limit."""
        now = time.monotonic()
        with self._lock:
            busy = bool(worker.jobs) or not worker.ready
            # Another worker that began later has done all of it. So this worker does not merely wait for a busy
            # computer.
            outrun = worker.ready and busy and all(queued.done for queued in worker.jobs)
            longest_s = (worker.job.longest_s if worker.job else None) or JOB_LIMIT_S
        since_s = worker.since_s if busy else worker.pinged_s
        limit_s = REPEATED_LIMIT_S if outrun else longest_s
        if since_s is not None and now - since_s > limit_s:
            worker.kill(limit_s)
        elif not busy and worker.pinged_s is None and now - (worker.seen_s or now) > PING_INTERVAL_S:
            worker.pinged_s = now
            self._send(worker, Ping())

    def _reap(self, worker: Worker) -> None:
        """Collect a worker process that has died, put its jobs back into the queues, and schedule its restart."""
        ended = worker.describe_end()
        with self._lock:
            self._queues.restart(worker)
            queued = worker.job
            waiting = [*worker.jobs][1:]
            worker.jobs.clear()
            # Only the job under way can have caused the death, so the attempts of the second job are not counted.
            for other in reversed(waiting):
                if not other.done and not self._is_under_way(other):
                    self._queues.put_back(other)
            worker.end()
            worker.restarts += 1
            worker.backoff.record_failure()
            given_up = queued is not None and not self._retry(queued)
            if given_up and queued is not None:
                queued.done = True
            self._dispatch()
        repeated = f" while doing {queued.job}, which another worker repeats" if queued and not given_up else ""
        self._report_end(f"Worker {worker.index} {ended}{repeated}; it is restarted.")
        if queued is not None and given_up:
            fault = f"{queued.job} was given up after {queued.deaths} attempt(s); its worker {ended}."
            action = "Ask once more. If it fails again, report it with a support bundle (vaoi bundle)."
            self._report(queued.job, Reply.refused(InternalError(fault, action=action, code="worker-lost")))

    def _report_end(self, sentence: str) -> None:
        _log.warning(sentence)
        if self._events is not None:
            self._events.worker_ended(sentence)

    def _retry(self, queued: Queued) -> bool:
        """Put the job of a dead worker at the front of its queue. Return False if the job must be given up."""
        if queued.done:
            return True
        queued.deaths, queued.began = queued.deaths + 1, None
        if self._is_under_way(queued):
            return True
        # A check cannot be repeated: its evidence was lost with the worker. The next run is checked again.
        if queued.deaths >= MAX_ATTEMPTS or isinstance(queued.job, CheckJob):
            return False
        self._queues.put_back(queued)
        return True

    def _is_under_way(self, queued: Queued) -> bool:
        """Return whether any worker has the job at present."""
        return any(queued in worker.jobs for worker in self._workers)

    def _dispatch(self) -> None:
        """Give each idle worker a job if one waits, and each worker that performs a link job a second link job."""
        now_s = time.monotonic()
        for worker in self._workers:
            worker.update(now_s)
        for worker in self._workers:
            if worker.idle and not worker.overdue:
                queued = self._queues.choose(worker) or self._queues.overdue(worker)
                if queued is not None:
                    self._give(worker, queued)
            if worker.ready and len(worker.jobs) == 1 and (following := self._queues.next_link(worker)) is not None:
                self._give(worker, following)

    def _give(self, worker: Worker, queued: Queued) -> None:
        if not worker.jobs:
            worker.since_s = time.monotonic()
        job = queued.job
        if isinstance(job, LinkJob | GatherJob | ConcludeJob):
            # The set-up of a run is sent in the same pipe before the run's first job, so that it arrives first.
            if job.run not in worker.opened:
                opening = self._queues.runs.get(job.run)
                if opening is None:
                    return  # The run was closed while an overdue worker had the job. The job is no longer needed.
                worker.opened.add(job.run)
                self._send(worker, opening)
            there = worker.evidence.setdefault(job.run, set())
            if isinstance(job, GatherJob):
                there.update(job.linked)
            if isinstance(job, ConcludeJob):
                # The conclude job contains all evidence that the worker lacks, so waiting gather jobs are not needed.
                self._queues.drop(Priority.GATHER, job.run)
                job = job.without(there)
        worker.jobs.append(queued)
        self._send(worker, job if queued.began is None else queued.continuation)

    def _send(self, worker: Worker, message: object) -> None:
        """Send a message to a worker that runs; the pool's thread sends what the pipe has no room for."""
        if worker.pipe is not None:
            worker.pipe.send(message)
            if worker.pipe.unsent:
                os.eventfd_write(self._wake, 1)

    def _abandoned(self) -> list[Queued]:
        with self._lock:
            # A job that is repeated is at two workers. It is reported only once.
            under_way = {id(q): q for w in self._workers for q in w.jobs if not q.done}.values()
            left = [*under_way, *self._queues.emptied()]
            for worker in self._workers:
                worker.jobs.clear()
            return left
