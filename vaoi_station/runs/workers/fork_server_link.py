"""The station's side of the fork server: it starts the server, requests workers, and replaces a server that ended."""

from __future__ import annotations

import logging
import multiprocessing
import os
import select
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from multiprocessing.context import SpawnProcess
from typing import Any, TypeAlias

from vaoi_station.backoff import Backoff, BackoffPolicy
from vaoi_station.runs.host.processes import keep_freed_memory
from vaoi_station.runs.states.run_ids import utc_of_host
from vaoi_station.runs.states.schemas import STARTING, ProcessStatus
from vaoi_station.runs.workers.fork_server import receive, run_fork_server, send

_log = logging.getLogger(__name__)

RESTART_POLICY = BackoffPolicy(first_s=0.25, longest_s=30.0, proven_s=30.0)
"""Pauses before a worker or a fork server that has died is restarted."""
START_LIMIT_S = 600.0
"""Longest time for the start of the fork server: the first one after an installation compiles, which takes minutes."""
PING_INTERVAL_S = 1.0
"""Time without a message after which the fork server is pinged."""
REPLY_LIMIT_S = 10.0
"""Longest time without a reply. After this time, the fork server counts as hung and is killed."""
END_S = 5.0
"""Longest wait for the end of a process. A killed one is then given up: the kernel cannot end it while it waits for a
disk."""
_MS_PER_S = 1000.0


class ChildProcess:
    """One process, also of another parent. Its pidfd stands for it alone, also after its pid was given to another."""

    def __init__(self, pid: int, pidfd: int) -> None:
        """Take over a pidfd. `close` closes it."""
        self.pid = pid
        self._pidfd = pidfd
        self.exit_code: int | None = None
        """Its exit code, negative for the number of a signal; None while it is unknown."""

    def fileno(self) -> int:
        """Return the pidfd, which is readable when the process has ended."""
        return self._pidfd

    def has_ended(self, timeout_s: float = 0.0) -> bool:
        """Wait until the process has ended, at most `timeout_s`, and return whether it has."""
        poll = select.poll()
        poll.register(self._pidfd, select.POLLIN)
        return bool(poll.poll(max(timeout_s, 0.0) * _MS_PER_S))

    def kill(self) -> None:
        """Kill the process at once. A process that has ended is left alone."""
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(self._pidfd, signal.SIGKILL)

    def close(self) -> None:
        """Close the pidfd. The process goes on if it still runs."""
        os.close(self._pidfd)


Outcome: TypeAlias = tuple[int, ChildProcess | str]
"""Index of a worker, and its process; or why it was not started."""


class ForkServerLink:
    """Starts the fork server, and requests workers of it. One thread uses it; `status` may be called from any thread.

    No call but `stop` waits for the fork server.
    """

    def __init__(self, report_end: Callable[[str], object], workers: int) -> None:
        """Prepare a link for a number of workers; `report_end` gets a sentence when a server ended or did not start."""
        self._report_end, self._count = report_end, workers
        self._backoff = Backoff(RESTART_POLICY)
        self._spawned: SpawnProcess | None = None
        self._process: ChildProcess | None = None
        """The same process by a pidfd: the `sentinel` would be open in its workers too, and thus not show its end."""
        self._control: socket.socket | None = None
        self._memory = os.memfd_create("vaoi-evidence")
        """The workers' evidence. It outlives a server, whose workers go on beside those of the next one."""
        self.ready = False
        """Whether workers may be requested."""
        self.progress = ""
        """Progress of the warm-up as text; empty before the first report, and when the server is ready."""
        self._restarts = 0
        self._seen_s: float | None = None
        """Time of the latest message, by time.monotonic(); None before the first message."""
        self._unanswered_s: float | None = None
        """Time of the oldest request without a reply, or of the start; None if there is none."""
        self._silent_s: float | None = None
        """Time without a reply after which the station has killed the server; None if it has not."""
        self._requested: set[int] = set()
        """Indices of the workers that are requested and not started yet."""
        self._workers: dict[int, ChildProcess] = {}
        """Workers of this server by their pid, until it has reported their exit code."""

    def status(self) -> ProcessStatus:
        """Return the state of the fork server, for `GET station` and the page."""
        process, seen_s, due_s = self._process, self._seen_s, self._backoff.due_s
        return ProcessStatus(
            name="fork server",
            pid=process.pid if process else None,
            alive=process is not None,
            restarts=self._restarts,
            heartbeat_age_s=None if seen_s is None else time.monotonic() - seen_s,
            doing="" if self.ready else STARTING,
            progress=self.progress,
            next_try=None if due_s is None else utc_of_host(due_s),
        )

    def descriptors(self) -> tuple[int, ...]:
        """Return the file descriptors that are readable when `outcomes` has work to do."""
        if self._control is None or self._process is None:
            return ()
        return self._control.fileno(), self._process.fileno()

    def pause_s(self) -> float:
        """Return the longest time until the next call of `outcomes`, s."""
        return PING_INTERVAL_S if self._process is not None else self._backoff.remaining_s()

    def will_report(self, worker: ChildProcess) -> bool:
        """Return whether the exit code of a worker that has ended is unknown and may still be reported."""
        return worker.pid in self._workers

    def request(self, index: int, ring: str, pipe: int) -> None:
        """Request a worker for a ring; `outcomes` reports what became of it. `pipe` is its end of its pipe, copied.

        Raises:
            OSError: the fork server has ended, or does not read.
        """
        if self._control is None:
            raise BrokenPipeError("the fork server has ended")
        self._send(("fork", index, ring), pipe)
        self._requested.add(index)

    def outcomes(self) -> Iterator[Outcome]:
        """Start the fork server if it is due, handle its messages, and yield what became of requested workers."""
        if self._process is None:
            if not self._backoff.remaining_s():
                self._start()
            return
        # Messages are read before the end is noticed, so that no exit code of a worker is lost.
        has_ended = self._process.has_ended()
        yield from self._received()
        if has_ended:
            yield from self._ended(self._process)
        else:
            self._check_liveness(self._process)

    def stop(self) -> None:
        """End the fork server once its workers have ended, and kill it if it has not ended after `END_S`."""
        if self._memory >= 0:
            os.close(self._memory)
            self._memory = -1
        process, control = self._process, self._control
        self._process = self._control = None
        if process is None or control is None:
            return
        control.close()
        # A server that warms up does not notice that the socket is closed.
        if not self.ready or not process.has_ended(END_S):
            process.kill()
        self.ready = False
        self._collect(process)

    def _start(self) -> None:
        self._backoff.start_attempt()
        try:
            here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            here.setblocking(False)
            # Not a daemon in the sense of `multiprocessing`, which may not have child processes.
            spawned = multiprocessing.get_context("spawn").Process(
                target=run_fork_server, args=(there, self._count), name="vaoi-forkserver"
            )
            try:
                # The server has a copy of its end. If it were open here, the socket would outlive the server.
                with there, keep_freed_memory():
                    spawned.start()
                assert spawned.pid is not None, "it was started"
                self._process = ChildProcess(spawned.pid, os.pidfd_open(spawned.pid))
                with suppress(OSError):  # It has ended already, which its pidfd shows.
                    send(here, ("memory",), self._memory)
            except OSError:
                here.close()
                raise
        except OSError as fault:
            # There is too little memory, or there are too many processes or files. This may pass.
            self._backoff.record_failure()
            self._report_end(f"The fork server could not be started ({fault}); it is tried again.")
            return
        self._spawned, self._control, self._unanswered_s = spawned, here, time.monotonic()

    def _send(self, message: tuple[object, ...], *descriptors: int) -> None:
        assert self._control is not None
        send(self._control, message, *descriptors)
        self._unanswered_s = self._unanswered_s or time.monotonic()

    def _received(self) -> Iterator[Outcome]:
        assert self._control is not None
        with suppress(BlockingIOError):
            while (received := receive(self._control)) is not None:
                self._seen_s = time.monotonic()
                yield from self._handle(*received)

    def _handle(self, message: tuple[Any, ...], descriptors: list[int]) -> Iterator[Outcome]:
        # The limit of a start is for all of it, however often its progress is reported.
        if message[0] != "starting":
            self._unanswered_s = None
        match message:
            case "starting", compiled, of:
                self.progress = f"{compiled} of {of} inner loops are compiled"
            case ("ready",):
                self.ready, self.progress = True, ""
                self._backoff.record_success()
            case "forked", index, pid:
                self._requested.discard(index)
                if descriptors:
                    worker = self._workers[pid] = ChildProcess(pid, descriptors[0])
                    yield index, worker
                else:
                    # Without its pipe, which the pool closes now, the worker ends.
                    yield index, "the station has too many open files"
            case "not-forked", index, why:
                self._requested.discard(index)
                yield index, why
            case "ended", pid, code:
                if (ended := self._workers.pop(pid, None)) is not None:
                    ended.exit_code = code

    def _check_liveness(self, process: ChildProcess) -> None:
        now_s = time.monotonic()
        limit_s = REPLY_LIMIT_S if self.ready else START_LIMIT_S
        if self._unanswered_s is not None:
            if now_s - self._unanswered_s > limit_s and self._silent_s is None:
                self._silent_s = limit_s
                process.kill()
        elif now_s - (self._seen_s or now_s) > PING_INTERVAL_S:
            with suppress(OSError):  # It has ended just now.
                self._send(("ping",))

    def _ended(self, process: ChildProcess) -> Iterator[Outcome]:
        """Collect a fork server that has ended, and schedule its restart. Its workers go on."""
        assert self._control is not None
        self._control.close()
        self._collect(process)
        self._process = self._control = self._seen_s = self._unanswered_s = None
        self.ready, self.progress = False, ""
        self._restarts += 1
        self._backoff.record_failure()
        silent_s, self._silent_s = self._silent_s, None
        how = f"ended with code {process.exit_code}" if silent_s is None else describe_silence(silent_s)
        self._report_end(f"The fork server {how}; it is restarted. Workers that run go on.")
        self._workers.clear()
        requested = [*self._requested]
        self._requested.clear()
        yield from ((index, "the fork server has ended") for index in requested)

    def _collect(self, process: ChildProcess) -> None:
        assert self._spawned is not None
        if process.has_ended(END_S):
            self._spawned.join()
            process.exit_code = self._spawned.exitcode
            self._spawned.close()
        else:
            _log.error("process %s of the fork server cannot be ended; it is left alone", process.pid)
        process.close()


def describe_silence(silent_s: float) -> str:
    """Describe how a process has ended that did not reply within a limit: the end of a sentence."""
    return f"did not answer for {silent_s:g} s, so that the station ended it"
