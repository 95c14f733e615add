"""The worker pool: it gives jobs to worker processes, and replaces processes that die or hang.

What happens when a worker dies: the pool notices it by the pidfd of its process (`_supervise`) and reaps it (`_reap`).
The job under way goes back to the front of its queue, for another worker; after `MAX_ATTEMPTS` deaths it is answered
with an error (`worker-lost`). The second job goes back as well. A new process is requested of the fork server after a
pause (`_run`). Evidence that the worker has found lies in its log, which outlives it. If it owned a run, its successor
concludes the run, or another worker if that is not ready; without a result the run fails (`RunStitcher`).

A worker has one job at a time, and a second one if both are links, so that it need not wait for the pool. A job that
takes much longer than usual is repeated by an idle worker (`OVERDUE_S`); the first worker is killed once it is certain
that it hangs. No call waits for a worker, so that one that hangs blocks no thread of the station.
"""

from __future__ import annotations

import atexit
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path

from vaoi_station.errors import StateError, VaoiError
from vaoi_station.runs.host.message_pipe import MessagePipe, PipeEndedError, wait_for
from vaoi_station.runs.states.schemas import ProcessStatus
from vaoi_station.runs.workers.fork_server_link import END_S, ChildProcess, ForkServerLink, describe_silence
from vaoi_station.runs.workers.jobs import (
    CloseRun,
    ConcludeJob,
    Job,
    Numbered,
    OpenRun,
    Paused,
    PictureJob,
    Ping,
    Reply,
    RunJob,
    WorkerLostError,
    WorkerReady,
)
from vaoi_station.runs.workers.queues import JobQueues, Queued, Worker
from vaoi_station.supervised_thread import SupervisedThread

_log = logging.getLogger(__name__)

JOB_LIMIT_S = 30.0
"""Longest time for one job. After this time, the worker counts as hung and is killed."""
REPEATED_LIMIT_S = 5.0
"""Longest time for a job that another worker has finished meanwhile; after it, the slower one counts as hung."""
PING_INTERVAL_S = 1.0
"""Time without a message after which an idle worker is pinged."""
CHECK_PERIOD_S = 0.5
"""Longest time between two checks of the workers' liveness."""
CODE_S = 0.5
"""Longest wait for the exit code of a worker that has ended; the fork server reports it at once, unless it hangs."""
STOP_S = 10.0
"""Longest wait for the pool's thread to end."""
MAX_ATTEMPTS = 2
"""Largest number of attempts at a job whose worker dies: a job that has killed two workers would kill a third too."""


class WorkerPool:
    """The worker processes of the station. Its methods may be called from any thread."""

    def __init__(self, count: int, ring_path: Path) -> None:
        self._ring_path = ring_path
        self._on_end: Callable[[str], object] = lambda _: None
        self._on_ready: Callable[[], object] = lambda: None
        self._workers = [Worker(k) for k in range(count)]
        self._queues = JobQueues(self._workers)
        self._lock = threading.RLock()
        self.fork_server = ForkServerLink(self._report_end, count)
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._stopping = False
        self.thread = SupervisedThread(self._run, "workers")

    def start(self, on_end: Callable[[str], object], on_ready: Callable[[], object]) -> None:
        """Start the workers. Both functions are called in any thread and must return at once.

        `on_end` gets a sentence when a worker has ended; it is replaced. `on_ready` is called when all are ready.
        """
        self._on_end, self._on_ready = on_end, on_ready
        # Workers ignore SIGTERM and SIGINT. Without this exit handler, they would survive a station that exits by an
        # exception.
        atexit.register(self.stop, 0.0)
        self.thread.start()

    def all_ready(self) -> bool:
        """Return whether every worker has finished its warm-up."""
        with self._lock:
            return all(w.ready for w in self._workers)

    def warm(self) -> bool:
        """Return whether boards may be filmed: a worker is ready, and each other one is ready too, or has failed."""
        with self._lock:
            return any(w.ready for w in self._workers) and all(w.ready or w.restarts for w in self._workers)

    def submit(self, job: Job, done: Callable[[Reply], object]) -> None:
        """Queue a job. `done` gets its reply once, in any thread, and must return at once.

        It is not called for a link job or conclusion that still waits when its run is closed.
        """
        refusal: VaoiError | None = StateError("The station is stopping; its workers take no more jobs.")
        with self._lock:
            if not self._stopping and (refusal := self._queues.refusal(job)) is None:
                self._queues.add(Queued(job, done))
                self._dispatch()
                return
        assert refusal is not None
        done(Reply.refused(refusal))

    def open_run(self, opening: OpenRun) -> None:
        """Announce a run, before its first job is submitted. Its owner takes over evidence from now on."""
        with self._lock:
            self._queues.runs[opening.context.run] = opening
            owner = self._workers[self._queues.owner]
            if owner.ready:
                self._open(owner, opening.context.run)

    def close_run(self, run: str) -> None:
        """Close a run: drop its waiting links and conclusion, and make the workers discard what they hold for it."""
        with self._lock:
            self._queues.forget(run)
            for worker in self._workers:
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
        """End all worker processes, at last by killing them, and refuse every unfinished job; once."""
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
        deadline_s = time.monotonic() + timeout_s
        for worker in self._workers:
            if worker.process is not None:
                worker.process.has_ended(deadline_s - time.monotonic())
            self._end(worker)
        self.fork_server.stop()
        with self._lock:
            # A job that is repeated is at two workers. It is refused only once.
            under_way = {id(q): q for w in self._workers for q in w.jobs if not q.answered}.values()
            left = [*under_way, *self._queues.emptied()]
            for worker in self._workers:
                worker.jobs.clear()
        for queued in left:
            queued.done(Reply.refused(StateError("The station was stopped before this was done.")))
        os.close(self._wake)

    # --- the pool's thread

    def _run(self) -> None:
        """Start workers, receive their messages, and reap workers that have died, until the pool is stopped."""
        while not self._stopping:
            self.thread.beat()
            for worker in self._absent():
                if not worker.backoff.remaining_s():
                    self._start(worker)
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
        return [w for w in self._workers if w.pipe is None] if self.fork_server.ready else []

    def _pause_s(self) -> float:
        now_s = time.monotonic()
        restarts_s = [self.fork_server.pause_s(), *(w.backoff.remaining_s() for w in self._absent())]
        with self._lock:
            due_s = [due_s - now_s for w in self._workers if not w.overdue and (due_s := w.due_s()) is not None]
        return max(min([CHECK_PERIOD_S, *restarts_s, *due_s]), 0.0)

    def _start(self, worker: Worker) -> None:
        worker.backoff.start_attempt()
        try:
            here, there = Pipe()
            # The process gets a copy of its end. If it were kept open here, the pipe would outlive the process.
            with there:
                self.fork_server.request(worker.index, str(self._ring_path), there.fileno())
        except OSError as fault:
            self._complete_start(worker, str(fault))
            return
        with self._lock:
            worker.pipe, worker.since_s = MessagePipe(here), time.monotonic()

    def _complete_start(self, worker: Worker, outcome: ChildProcess | str) -> None:
        if isinstance(outcome, ChildProcess):
            with self._lock:
                worker.process = outcome
            return
        # There may be too little memory, or too many processes or files. This may pass.
        self._end(worker)
        worker.backoff.record_failure()
        self._report_end(f"Worker {worker.index} could not be started ({outcome}); it is tried again.")

    def _receive(self, worker: Worker) -> None:
        assert worker.pipe is not None
        worker.pipe.flush()
        try:
            messages = worker.pipe.receive()
        except PipeEndedError:
            # A worker without its pipe is useless. After it was killed, `_supervise` reaps it.
            if worker.process is not None:
                worker.process.kill()
            return
        for message in messages:
            worker.seen_s, worker.pinged_s = time.monotonic(), None
            if isinstance(message, WorkerReady) and not worker.ready:  # later ones are replies to pings
                self._handle_ready(worker)
            elif isinstance(message, Reply) and worker.jobs:
                self._handle_reply(worker, message)

    def _handle_ready(self, worker: Worker) -> None:
        with self._lock:
            worker.ready = True
            worker.backoff.record_success()
            if worker.index == self._queues.owner:
                for run in self._queues.runs:
                    self._open(worker, run)
            complete = self.all_ready()
            self._dispatch()
        if complete:
            self._on_ready()

    def _handle_reply(self, worker: Worker, reply: Reply) -> None:
        with self._lock:
            queued, worker.since_s = worker.jobs.popleft(), time.monotonic()
            if isinstance(reply.value, Paused):
                self._queues.pause(queued, worker)
                self._dispatch()
                return
            # A job that was repeated has two replies. The first one counts.
            first, queued.answered = not queued.answered, True
            if first and isinstance(queued.job, ConcludeJob):
                self._queues.concluded(queued.job.run, worker)
            self._dispatch()
        # Outside the lock: the receiver may call back into the pool.
        if first:
            queued.done(reply)

    def _supervise(self, worker: Worker) -> None:
        if worker.process is None or worker.pipe is None:
            return
        if not worker.process.has_ended():
            self._check_liveness(worker, worker.process)
            return
        now_s = time.monotonic()
        worker.ended_s = worker.ended_s or now_s
        if not self.fork_server.will_report(worker.process) or now_s - worker.ended_s >= CODE_S:
            # The worker may have sent a reply before it died. A finished job must not be repeated.
            self._receive(worker)
            self._reap(worker)

    def _check_liveness(self, worker: Worker, process: ChildProcess) -> None:
        now_s = time.monotonic()
        with self._lock:
            busy = bool(worker.jobs) or not worker.ready
            # Another worker that began later has done all of it. So this worker does not merely wait for a busy
            # computer.
            outrun = worker.ready and busy and all(queued.answered for queued in worker.jobs)
            longest_s = (worker.job.longest_s if isinstance(worker.job, PictureJob) else None) or JOB_LIMIT_S
        since_s = worker.since_s if busy else worker.pinged_s
        limit_s = REPEATED_LIMIT_S if outrun else longest_s
        if since_s is not None and now_s - since_s > limit_s:
            worker.silent_s = limit_s
            process.kill()
        elif not busy and worker.pinged_s is None and now_s - (worker.seen_s or now_s) > PING_INTERVAL_S:
            worker.pinged_s = now_s
            self._send(worker, Ping())

    def _reap(self, worker: Worker) -> None:
        """Collect a worker that has died, put its jobs back into the queues, and schedule its replacement."""
        code = worker.process.exit_code if worker.process else None
        how = f"ended with code {code}" if code is not None else "ended with an unknown code"
        if worker.silent_s is not None:
            how = describe_silence(worker.silent_s)
        given_up: Queued | None = None
        with self._lock:
            self._queues.restart(worker)
            jobs = [*worker.jobs]
            worker.jobs.clear()
            self._end(worker)
            worker.restarts += 1
            worker.backoff.record_failure()
            # Only the job under way can have caused the death, so the attempts of the second job are not counted. The
            # last one comes first, because each goes to the front.
            for queued in reversed([q for q in jobs if not q.answered]):
                queued.deaths += queued is jobs[0]
                queued.began = None
                if any(queued in other.jobs for other in self._workers):
                    continue  # another worker repeats it already
                if queued.deaths >= MAX_ATTEMPTS:
                    given_up, queued.answered = queued, True
                else:
                    self._queues.put_back(queued)
            self._dispatch()
        repeated = f" while doing {jobs[0].job}" if jobs else ""
        self._report_end(f"Worker {worker.index} {how}{repeated}; it is restarted.")
        if given_up is not None:
            fault = f"{given_up.job} was given up after {given_up.deaths} attempt(s); its worker {how}."
            action = "Film the board or ask for the picture again. If it recurs, send a support bundle (vaoi bundle)."
            given_up.done(Reply.refused(WorkerLostError(fault, action=action)))

    def _end(self, worker: Worker) -> None:
        """Kill a worker's process if it still runs, wait for its end, close its handles, and forget what it held."""
        with self._lock:
            process, pipe = worker.process, worker.pipe
            worker.process = worker.pipe = worker.silent_s = worker.ended_s = worker.pinged_s = None
            worker.ready = False
            worker.opened.clear()
        if process is not None:
            process.kill()
            if not process.has_ended(END_S):
                _log.error("process %s of worker %d cannot be ended; it is left alone", process.pid, worker.index)
            process.close()
        if pipe is not None:
            pipe.close()

    def _report_end(self, sentence: str) -> None:
        _log.warning(sentence)
        self._on_end(sentence)

    # --- giving jobs, under the lock

    def _dispatch(self) -> None:
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
        if isinstance(job, RunJob) and not self._open(worker, job.run):
            return  # The run was closed while an overdue worker had the job. The job is no longer needed.
        worker.jobs.append(queued)
        self._send(worker, Numbered(queued.number, job if queued.began is None else None))

    def _open(self, worker: Worker, run: str) -> bool:
        """Send a worker the set-up of a run unless it has it; return False if the run is not open."""
        opening = self._queues.runs.get(run)
        if opening is not None and run not in worker.opened:
            worker.opened.add(run)
            self._send(worker, replace(opening, owned=worker.index == self._queues.owner))
        return opening is not None

    def _send(self, worker: Worker, message: object) -> None:
        """Send a message to a worker that runs; the pool's thread sends what the pipe has no room for."""
        if worker.pipe is not None:
            worker.pipe.send(message)
            if worker.pipe.unsent:
                os.eventfd_write(self._wake, 1)
