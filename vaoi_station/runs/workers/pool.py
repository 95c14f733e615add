"""k worker processes: who does what next, and what happens when one dies.

Jobs wait here, not in the workers' pipes: each worker has one job in its hands, and while frames come one more
of its own, so that it need not wait for us between two. A worker that dies is noticed at once by its
sentinel; its jobs go to another one and a new worker takes its place. A job that has taken two
workers with it is given back with the reason.
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
"""A worker that takes longer for one job is taken for hung and killed."""
START_LIMIT_S = 600.0
"""The same before it says that it is there: after an installation the first ones compile, under load for minutes."""
PULSE_S = 1.0
"""An idle worker is asked for a sign of life so often."""
LIVES = 2
"""Workers one job may take with it."""


class WorkerPool:
    """The workers; `submit` from any thread, answers come in the pool's own thread."""

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
        """Start the processes and report to `events`; jobs may be submitted before the workers are ready."""
        self._events = events
        atexit.register(self.stop, 0.0)  # workers leave SIGTERM to the station: nobody else would end them
        self._thread.start()

    def all_ready(self) -> bool:
        """Whether every worker is there and warm; jobs need not wait for that."""
        with self._lock:
            return all(w.ready for w in self._workers)

    def submit(self, job: Job) -> None:
        """Have a job done; its answer is reported once, with a value or a reason."""
        with self._lock:
            if not self._stopping:
                self._queues.add(Queued(job))
                self._dispatch()
                return
        self._report(job, _refused(StateError("The station is stopping; its workers take no more jobs.")))

    def open_run(self, opening: OpenRun) -> None:
        """Jobs of a run are about to come."""
        with self._lock:
            self._queues.runs[opening.context.run] = opening

    def close_run(self, run: str) -> None:
        """Nothing more of a run will be asked for: links that still wait are dropped, workers forget it."""
        with self._lock:
            self._queues.forget(run)
            for worker in self._workers:
                worker.evidence.pop(run, None)
                if run in worker.opened and worker.connection is not None:
                    worker.opened.discard(run)
                    _send(worker.connection, CloseRun(run))

    def status(self) -> tuple[ProcessStatus, ...]:
        """How every worker does."""
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
        """End the workers and give every waiting job back; no process is left behind."""
        with self._lock:
            if self._stopping:
                return
            self._stopping = True
        atexit.unregister(self.stop)
        self._wake_there.send_bytes(b"stop")
        if self._thread.ident is not None:
            self._thread.join()
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
        """Start, listen, notice deaths, until stopped; all of the pool's waiting happens here."""
        while not self._stopping:
            for worker in self._workers:
                if worker.process is None and not worker.backoff.remaining_s():
                    self._begin(worker)
            sources: dict[Any, Worker] = {}
            for worker in self._workers:
                if worker.process is not None:
                    sources[worker.connection] = sources[worker.process.sentinel] = worker
            pauses_s = [w.backoff.remaining_s() for w in self._workers if w.process is None]
            for source in wait([self._wake_here, *sources], timeout=min([0.5, *pauses_s])):
                if source is self._wake_here:
                    self._wake_here.recv_bytes()
                elif source is sources[source].connection:
                    self._listen(sources[source])
            for worker in {w.index: w for w in sources.values()}.values():
                self._look_after(worker)

    def _begin(self, worker: Worker) -> None:
        worker.backoff.start_attempt()
        here, there = self._spawn.Pipe()
        process = self._spawn.Process(
            target=run_worker, args=(there, str(self._ring_path)), name=f"vaoi-worker-{worker.index}", daemon=True
        )
        with keep_freed_memory():
            process.start()
        there.close()
        with self._lock:
            worker.process, worker.connection, worker.since_s = process, here, time.monotonic()

    def _listen(self, worker: Worker) -> None:
        """Take one message of a worker; an end of its pipe is left to its sentinel."""
        assert worker.connection is not None
        try:
            message = worker.connection.recv()
        except (EOFError, ConnectionResetError):
            _kill(worker.process)
            return
        worker.seen_s, worker.asked_s = time.monotonic(), None
        queued, complete = None, False
        with self._lock:
            if isinstance(message, Reply) and worker.jobs:
                queued, worker.since_s = worker.jobs.popleft(), time.monotonic()
                self._queues.pass_on(worker, queued.job, message)
            if isinstance(message, WorkerReady) and not worker.ready:  # later ones are signs of life
                worker.ready = True
                worker.backoff.record_success()
                complete = self.all_ready()
            self._dispatch()
        if complete and self._events is not None:
            self._events.workers_ready()
        if isinstance(message, Reply) and queued is not None:
            self._report(queued.job, message)

    def _report(self, job: Job, answer: Reply) -> None:
        """Report the outcome of a submitted job; gathering is the pool's own work and is not reported."""
        if self._events is not None and not isinstance(job, GatherJob):
            self._events.worker_reply(job, answer)

    def _look_after(self, worker: Worker) -> None:
        """Notice that a worker has died, and kill one that hangs."""
        if worker.process is None:
            return
        if worker.process.is_alive():
            self._feel_pulse(worker)
            return
        while worker.connection is not None and worker.job is not None and worker.connection.poll():
            before = worker.job  # its last answer may still lie in the pipe
            self._listen(worker)
            if worker.job is before:
                break
        self._bury(worker)

    def _feel_pulse(self, worker: Worker) -> None:
        """Ask an idle worker for a sign of life; kill one that hangs."""
        now = time.monotonic()
        busy = worker.job is not None or not worker.ready
        since_s = worker.since_s if busy else worker.asked_s
        limit_s = JOB_LIMIT_S if worker.ready else START_LIMIT_S
        if since_s is not None and now - since_s > limit_s:
            _kill(worker.process)
        elif not busy and worker.asked_s is None and now - (worker.seen_s or now) > PULSE_S:
            worker.asked_s = now
            assert worker.connection is not None
            with self._lock:
                _send(worker.connection, Ping())

    def _bury(self, worker: Worker) -> None:
        assert worker.process is not None
        process, code = worker.process, worker.process.exitcode
        with self._lock:
            queued = worker.job
            for waiting in reversed([*worker.jobs][1:]):
                self._queues.put_back(waiting)
            worker.jobs.clear()
            _end(process, worker.connection)
            worker.process = worker.connection = None
            worker.ready, worker.asked_s = False, None
            worker.opened.clear()
            worker.evidence.clear()
            worker.restarts += 1
            worker.backoff.record_failure()
            spent = queued is not None and self._again(queued)
            self._dispatch()
        sentence = f"Worker {worker.index} ended with code {code}" + (
            f" while doing {queued.job}; another one does it." if queued and not spent else "; it is started again."
        )
        _log.warning(sentence)
        if self._events is not None:
            self._events.worker_ended(sentence)
        if queued is not None and spent:
            fault = f"{queued.job} took {LIVES} workers with it; the last ended with code {code}."
            self._report(queued.job, _refused(InternalError(fault, code="worker-lost")))

    def _again(self, queued: Queued) -> bool:
        """Put a dead worker's job in front of the queue; True if it has had all its lives."""
        queued.deaths += 1
        if queued.deaths >= LIVES:
            return True
        self._queues.put_back(queued)
        return False

    def _dispatch(self) -> None:
        """Give every idle worker the job that suits it best."""
        for worker in self._workers:
            if worker.idle and (queued := self._queues.choose(worker)) is not None:
                self._hand(worker, queued)
            if worker.ready and len(worker.jobs) == 1 and (queued := self._queues.next_link(worker)) is not None:
                self._hand(worker, queued)

    def _hand(self, worker: Worker, queued: Queued) -> None:
        assert worker.connection is not None
        if not worker.jobs:
            worker.since_s = time.monotonic()
        worker.jobs.append(queued)
        job = queued.job
        if isinstance(job, LinkJob | GatherJob | ConcludeJob):
            if job.run not in worker.opened:
                worker.opened.add(job.run)
                _send(worker.connection, self._queues.runs[job.run])
            there = worker.evidence.setdefault(job.run, set())
            if isinstance(job, GatherJob):
                there.update(job.linked)
            if isinstance(job, ConcludeJob):
                self._queues.drop(Priority.GATHER, job.run)
                job = job.without(there)
        _send(worker.connection, job)

    def _abandoned(self) -> list[Queued]:
        with self._lock:
            left = [q for w in self._workers for q in w.jobs] + self._queues.emptied()
            for worker in self._workers:
                worker.jobs.clear()
            return left


def _refused(error: StateError | InternalError) -> Reply:
    return Reply(None, error, 0.0)


def _send(connection: Connection[Any, Any], message: object) -> None:
    try:
        connection.send(message)
    except (BrokenPipeError, ConnectionResetError):
        return  # the worker has died; its sentinel says so in a moment, and its job is given to another


def _kill(process: BaseProcess | None) -> None:
    if process is not None:
        process.kill()


def _end(process: BaseProcess, connection: Connection[Any, Any] | None) -> None:
    """Make sure a process is gone, and give back what it held here."""
    if process.is_alive():
        process.kill()
    process.join()
    process.close()
    if connection is not None:
        connection.close()
