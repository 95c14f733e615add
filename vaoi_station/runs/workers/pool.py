"""The worker pool: it gives jobs to worker processes, and restarts processes that die or hang.

Jobs wait in the pool, not in the pipes to the workers. A worker has one job at a time. A worker that performs a link
job may get a second link job, so that it need not wait for the pool in between. The pool detects the end of a worker at
once by the sentinel of its process. The worker's jobs then go to another worker, and the process is restarted. A job
whose workers died `MAX_ATTEMPTS` times is given up with an error.
"""

from __future__ import annotations

import atexit
import logging
import multiprocessing
import threading
import time
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from vaoi_station.errors import InternalError, StateError
from vaoi_station.runs.host.process_setup import keep_freed_memory
from vaoi_station.runs.states.run_ids import utc_of_host
from vaoi_station.runs.states.schemas import STARTING, ProcessStatus
from vaoi_station.runs.workers.jobs import (
    CheckJob,
    CloseRun,
    ConcludeJob,
    GatherJob,
    Job,
    LinkJob,
    OpenRun,
    Ping,
    Priority,
    Reply,
    WorkerReady,
)
from vaoi_station.runs.workers.queues import JobQueues, Queued, Worker
from vaoi_station.runs.workers.worker_events import WorkerEvents
from vaoi_station.runs.workers.worker_process import run_worker

_log = logging.getLogger(__name__)

JOB_LIMIT_S = 30.0
"""Longest time for one job. After this time, the worker counts as hung and is killed."""
START_LIMIT_S = 600.0
"""Longest time for the start of a worker. The first start after an installation compiles, which takes minutes."""
PING_INTERVAL_S = 1.0
"""Time without a message after which an idle worker is pinged."""
MAX_ATTEMPTS = 2
"""Largest number of attempts at a job whose worker dies: a job that has killed two workers would kill a third too."""


class WorkerPool:
    """The worker processes of the station. Its methods may be called from any thread.

    It reports to the `WorkerEvents` given at the start, mostly in its own thread.
    """

    def __init__(self, count: int, ring_path: Path) -> None:
        self._ring_path = ring_path
        self._events: WorkerEvents | None = None
        self._spawn = multiprocessing.get_context("spawn")
        self._workers = [Worker(k) for k in range(count)]
        self._queues = JobQueues(self._workers)
        self._lock = threading.RLock()
        self._wake_here, self._wake_there = multiprocessing.Pipe(duplex=False)
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="workers", daemon=True)

    def start(self, events: WorkerEvents) -> None:
        """Start the workers, and report to `events`. Jobs may be submitted before the workers are ready."""
        self._events = events
        # Workers ignore SIGTERM and SIGINT. Without this exit handler they would survive a station that exits by an
        # exception.
        atexit.register(self.stop, 0.0)
        self._thread.start()

    def all_ready(self) -> bool:
        """Return whether every worker has finished its warm-up."""
        with self._lock:
            return all(w.ready for w in self._workers)

    def submit(self, job: Job) -> None:
        """Queue a job; its reply is reported by `WorkerEvents.worker_reply`."""
        with self._lock:
            if not self._stopping:
                self._queues.add(Queued(job))
                self._dispatch()
                return
        self._report(job, _refused(StateError("The station is stopping; its workers take no more jobs.")))

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
                if run in worker.opened and worker.connection is not None:
                    worker.opened.discard(run)
                    _send(worker.connection, CloseRun(run))

    def status(self) -> tuple[ProcessStatus, ...]:
        """Return the state of every worker."""
        now = time.monotonic()
        with self._lock:
            return tuple(
                ProcessStatus(
                    name=f"worker {w.index}",
                    pid=w.process.pid if w.process else None,
                    alive=w.process is not None and w.process.is_alive(),
                    restarts=w.restarts,
                    heartbeat_age_s=None if w.seen_s is None else now - w.seen_s,
                    doing=str(w.job.job) if w.job else "idle" if w.ready else STARTING,
                    next_try=None if w.backoff.due_s is None else utc_of_host(w.backoff.due_s),
                )
                for w in self._workers
            )

    def stop(self, timeout_s: float = 5.0) -> None:
        """End all worker processes, and report an error for every unfinished job. A second call does nothing.

        Workers that have not ended after `timeout_s` are killed.
        """
        with self._lock:
            if self._stopping:
                return
            self._stopping = True
        atexit.unregister(self.stop)
        self._wake_there.send_bytes(b"stop")
        if self._thread.ident is not None:
            self._thread.join()
        # All workers are asked to end before the first one is awaited, so that they end in parallel.
        deadline = time.monotonic() + timeout_s
        for worker in self._workers:
            if worker.connection is not None:
                _send(worker.connection, None)
        for worker in self._workers:
            if worker.process is not None:
                worker.process.join(max(0.0, deadline - time.monotonic()))
                _end(worker.process, worker.connection)
        for queued in self._abandoned():
            self._report(queued.job, _refused(StateError("The station was stopped before this was done.")))
        self._wake_here.close()
        self._wake_there.close()

    def _run(self) -> None:
        """Start workers, receive their messages, and reap workers that have died, until the pool is stopped."""
        while not self._stopping:
            for worker in self._workers:
                if worker.process is None and not worker.backoff.remaining_s():
                    self._start_worker(worker)
            sources: dict[Any, Worker] = {}
            for worker in self._workers:
                if worker.process is not None:
                    sources[worker.connection] = sources[worker.process.sentinel] = worker
            # The wait ends after 0.5 s at the latest, for the liveness checks below, and at the earliest restart.
            pauses_s = [w.backoff.remaining_s() for w in self._workers if w.process is None]
            for source in wait([self._wake_here, *sources], timeout=min([0.5, *pauses_s])):
                if source is self._wake_here:
                    self._wake_here.recv_bytes()
                elif source is sources[source].connection:
                    self._receive(sources[source])
            for worker in {w.index: w for w in sources.values()}.values():
                self._supervise(worker)

    def _start_worker(self, worker: Worker) -> None:
        worker.backoff.start_attempt()
        here, there = self._spawn.Pipe()
        process = self._spawn.Process(
            target=run_worker, args=(there, str(self._ring_path)), name=f"vaoi-worker-{worker.index}", daemon=True
        )
        with keep_freed_memory():
            process.start()
        # The child process has a copy of this end. If the parent kept it open, `recv` would not notice the child's
        # death.
        there.close()
        with self._lock:
            worker.process, worker.connection, worker.since_s = process, here, time.monotonic()

    def _receive(self, worker: Worker) -> None:
        """Handle one message of a worker: that it is ready, or the reply to a job."""
        assert worker.connection is not None
        try:
            message = worker.connection.recv()
        except (EOFError, ConnectionResetError):
            # A worker without its pipe is useless. After it was killed, `_supervise` reaps it.
            _kill(worker.process)
            return
        worker.seen_s, worker.pinged_s = time.monotonic(), None
        queued, complete = None, False
        with self._lock:
            if isinstance(message, Reply) and worker.jobs:
                queued, worker.since_s = worker.jobs.popleft(), time.monotonic()
                self._queues.share_evidence(worker, queued.job, message)
                if (check := _check_that_follows(queued.job, message)) is not None:
                    # The worker performs the check already. It is entered as the job under way, so that other jobs go
                    # to free workers until the check's reply, and JOB_LIMIT_S limits its time.
                    worker.jobs.appendleft(Queued(check))
            # The first WorkerReady ends the warm-up; later ones are replies to pings.
            if isinstance(message, WorkerReady) and not worker.ready:
                worker.ready = True
                worker.backoff.record_success()
                complete = self.all_ready()
            self._dispatch()
        # Reports are made outside the lock: a receiver may call back into the pool.
        if complete and self._events is not None:
            self._events.workers_ready()
        if isinstance(message, Reply) and queued is not None:
            self._report(queued.job, message)

    def _report(self, job: Job, reply: Reply) -> None:
        """Report the outcome of a job. Gather jobs are not reported, because only the pool submits them."""
        if self._events is not None and not isinstance(job, GatherJob):
            self._events.worker_reply(job, reply)

    def _supervise(self, worker: Worker) -> None:
        """Reap a worker that has died, and kill a worker that hangs."""
        if worker.process is None:
            return
        if worker.process.is_alive():
            self._check_liveness(worker)
            return
        while worker.connection is not None and worker.job is not None and worker.connection.poll():
            # The worker may have sent a reply before it died. A finished job must not be repeated.
            before = worker.job
            self._receive(worker)
            if worker.job is before:
                break
        self._reap(worker)

    def _check_liveness(self, worker: Worker) -> None:
        """Ping an idle worker, and kill a worker that exceeds its time limit."""
        now = time.monotonic()
        busy = worker.job is not None or not worker.ready
        since_s = worker.since_s if busy else worker.pinged_s
        limit_s = JOB_LIMIT_S if worker.ready else START_LIMIT_S
        if since_s is not None and now - since_s > limit_s:
            _kill(worker.process)
        elif not busy and worker.pinged_s is None and now - (worker.seen_s or now) > PING_INTERVAL_S:
            worker.pinged_s = now
            assert worker.connection is not None
            with self._lock:
                _send(worker.connection, Ping())

    def _reap(self, worker: Worker) -> None:
        """Collect a worker process that has died, put its jobs back into the queues, and schedule its restart."""
        assert worker.process is not None
        process, code = worker.process, worker.process.exitcode
        with self._lock:
            queued = worker.job
            # Only the job under way can have caused the death, so the attempts of the second job are not counted.
            for waiting in reversed([*worker.jobs][1:]):
                self._queues.put_back(waiting)
            worker.jobs.clear()
            _end(process, worker.connection)
            worker.process = worker.connection = None
            worker.ready, worker.pinged_s = False, None
            worker.opened.clear()
            worker.evidence.clear()
            worker.restarts += 1
            worker.backoff.record_failure()
            given_up = queued is not None and not self._retry(queued)
            self._dispatch()
        repeated = f" while doing {queued.job}, which another worker repeats" if queued and not given_up else ""
        sentence = f"Worker {worker.index} ended with code {code}{repeated}; it is restarted."
        _log.warning(sentence)
        if self._events is not None:
            self._events.worker_ended(sentence)
        if queued is not None and given_up:
            fault = f"{queued.job} was given up after {queued.deaths} attempt(s); its worker ended with code {code}."
            self._report(queued.job, _refused(InternalError(fault, code="worker-lost")))

    def _retry(self, queued: Queued) -> bool:
        """Put the job of a dead worker at the front of its queue. Return False if the job must be given up."""
        queued.deaths += 1
        # A check cannot be repeated: its evidence was lost with the worker. The next run is checked again.
        if queued.deaths >= MAX_ATTEMPTS or isinstance(queued.job, CheckJob):
            return False
        self._queues.put_back(queued)
        return True

    def _dispatch(self) -> None:
        """Give each idle worker a job if one waits, and each worker that performs a link job a second link job."""
        for worker in self._workers:
            if worker.idle and (queued := self._queues.choose(worker)) is not None:
                self._give(worker, queued)
            if worker.ready and len(worker.jobs) == 1 and (queued := self._queues.next_link(worker)) is not None:
                self._give(worker, queued)

    def _give(self, worker: Worker, queued: Queued) -> None:
        assert worker.connection is not None
        if not worker.jobs:
            worker.since_s = time.monotonic()
        worker.jobs.append(queued)
        job = queued.job
        if isinstance(job, LinkJob | GatherJob | ConcludeJob):
            # The set-up of a run is sent in the same pipe before the run's first job, so that it arrives first.
            if job.run not in worker.opened:
                worker.opened.add(job.run)
                _send(worker.connection, self._queues.runs[job.run])
            there = worker.evidence.setdefault(job.run, set())
            if isinstance(job, GatherJob):
                there.update(job.linked)
            if isinstance(job, ConcludeJob):
                # The conclude job contains all evidence that the worker lacks, so waiting gather jobs are not needed.
                self._queues.drop(Priority.GATHER, job.run)
                job = job.without(there)
        _send(worker.connection, job)

    def _abandoned(self) -> list[Queued]:
        with self._lock:
            left = [q for w in self._workers for q in w.jobs] + self._queues.emptied()
            for worker in self._workers:
                worker.jobs.clear()
            return left


def _check_that_follows(job: Job, reply: Reply) -> CheckJob | None:
    """Return the check that the worker performs after this reply; None if there is none (`WorkerRuntime.replies`)."""
    return job.check if isinstance(job, ConcludeJob) and reply.error is None else None


def _refused(error: StateError | InternalError) -> Reply:
    return Reply(None, error, 0.0)


def _send(connection: Connection[Any, Any], message: object) -> None:
    try:
        connection.send(message)
    except (BrokenPipeError, ConnectionResetError):
        # The worker has died. The pool's thread reaps it in a moment and gives its job to another worker.
        return


def _kill(process: BaseProcess | None) -> None:
    if process is not None:
        process.kill()


def _end(process: BaseProcess, connection: Connection[Any, Any] | None) -> None:
    """Kill a process if it still runs, wait for its end, and close its handles."""
    if process.is_alive():
        process.kill()
    process.join()
    process.close()
    if connection is not None:
        connection.close()
