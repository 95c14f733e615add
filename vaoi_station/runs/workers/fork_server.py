"""The fork server: it imports and warms up once, and then forks each worker that the station requests.

A worker that is forked has all modules and all machine code at once, and shares their memory with the others. A process
that forks must have one thread only: a lock that another thread holds would stay locked in the child for ever. Why not
`multiprocessing.forkserver`: docs/decisions/0016.

| message to the server | reply | with |
|---|---|---|
| `memory`, the first one | | the file with the workers' evidence |
| `fork`, index, ring's path | `forked`, index, pid; or `not-forked`, index, why | its end of its pipe; a pidfd |
| `ping` | `ready` | |
| | `starting`, inner loops compiled, of how many: once a second until `ready` | |
| | `ended`, pid, exit code (negative for a signal) | |
"""

from __future__ import annotations

import gc
import logging
import multiprocessing
import os
import pickle
import signal
import socket
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from vaoi_station.runs.host.processes import set_process_title, set_up_process

if TYPE_CHECKING:
    import mmap

_log = logging.getLogger(__name__)

PROGRESS_S = 1.0
"""Time between two reports of the progress of the warm-up."""
_LONGEST_BYTES = 1 << 16
"""Longest message; it has a path and a few numbers."""


def send(to: socket.socket, message: tuple[object, ...], *descriptors: int) -> None:
    """Send a message with copies of file descriptors; OSError if the other side has ended, or does not read."""
    socket.send_fds(to, [pickle.dumps(message)], descriptors)


def receive(source: socket.socket) -> tuple[Any, list[int]] | None:
    """Return the next message and its file descriptors, which belong to the caller; None if the other side has ended.

    A process that has no room for further file descriptors receives the message without them. `BlockingIOError`: there
    is no message, and the socket does not block.
    """
    try:
        data, descriptors, _, _ = socket.recv_fds(source, _LONGEST_BYTES, 1)
    except ConnectionResetError:
        return None
    for descriptor in descriptors:
        # `recv_fds` makes them inheritable: a program that is started meanwhile would keep them open.
        os.set_inheritable(descriptor, False)
    return (pickle.loads(data), descriptors) if data else None


def run_fork_server(control: socket.socket, workers: int) -> None:
    """Warm up, and fork workers until the station closes the socket. End after the last worker has ended."""
    set_up_process(one_thread=True)
    # Automatic collections are off, because a full collection would delay a result, and scan what is imported again and
    # again. Workers collect after a run was closed and while they are idle.
    gc.disable()
    # These imports come after the set-up: OpenBLAS and OpenMP read the number of threads from the environment when they
    # are loaded.
    import cv2

    from vaoi_station.runs.workers import picture_jobs  # noqa: F401  jobs come pickled
    from vaoi_station.runs.workers.evidence_log import shared_memory
    from vaoi_station.runs.workers.second_compiler import SecondCompiler
    from vaoi_station.runs.workers.worker import run_worker  # noqa: F401  for the workers: see `_work`

    # OpenCV starts one thread per core by default. Such threads would slow down other workers, and this process could
    # not fork.
    cv2.setNumThreads(1)
    # The station may end without a message. This process must not continue without it.
    with control, suppress(ConnectionError):
        match receive(control):
            case ("memory",), [file]:
                server = _Server(control, workers, shared_memory(workers, file))
                os.close(file)
            case _:
                return
        second = SecondCompiler()
        with _progress_sent(control):
            second.warm_up()
        # Imported and compiled objects are never freed: `freeze` excludes them from collections, which would write to
        # the memory that all workers share.
        gc.collect()
        gc.freeze()
        send(control, ("ready",))
        try:
            server.serve(second.note_end)
        finally:
            second.close()
    for pid in server.children.values():
        os.waitpid(pid, 0)


@contextmanager
def _progress_sent(control: socket.socket) -> Iterator[None]:
    from vaoi_station.compiled import progress

    def report(*_: object) -> None:
        with suppress(OSError):  # The station has ended. This is noticed at the end of the warm-up.
            send(control, ("starting", *progress()))

    # A timer, because a thread may exist in the kernel for some time after it was joined.
    signal.signal(signal.SIGALRM, report)
    signal.setitimer(signal.ITIMER_REAL, PROGRESS_S, PROGRESS_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)


class _Server:
    def __init__(self, control: socket.socket, workers: int, logs: mmap.mmap) -> None:
        self._control, self._workers, self._logs = control, workers, logs
        self.children: dict[int, int] = {}
        """The pid of each worker that runs, by its pidfd."""

    def serve(self, between: Callable[[], object]) -> None:
        """Fork workers and report their ends until the station closes the socket; call `between` in between."""
        while True:
            ready = wait([self._control, *self.children])
            between()
            for pidfd in self.children.keys() & set(ready):
                pid = self.children.pop(pidfd)
                os.close(pidfd)
                send(self._control, ("ended", pid, os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])))
            if self._control not in ready:
                continue
            match receive(self._control):
                case None:
                    return
                case ("ping",), _:
                    send(self._control, ("ready",))
                case ("fork", index, ring), [pipe]:
                    outcome, descriptors = self._started(index, ring, pipe)
                    # Before the report, so that the worker alone has its end of the pipe when it is reported.
                    os.close(pipe)
                    send(self._control, outcome, *descriptors)
                case ("fork", index, _), _:
                    send(self._control, ("not-forked", index, "the fork server has too many open files"))

    def _started(self, index: int, ring: str, pipe: int) -> tuple[tuple[object, ...], list[int]]:
        try:
            pid = self._forked(index, ring, pipe)
            try:
                pidfd = os.pidfd_open(pid)
            except OSError:
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
                raise
        except OSError as fault:
            # There is too little memory, or there are too many processes or files. This may pass.
            return ("not-forked", index, str(fault)), []
        self.children[pidfd] = pid
        return ("forked", index, pid), [pidfd]

    def _forked(self, index: int, ring: str, pipe: int) -> int:
        """Fork a worker, and return its pid. In the worker, this function does not return."""
        if others := _other_threads():
            raise OSError(f"the fork server has other threads: {', '.join(others)}")
        # A child process would write once more what its parent has not written yet.
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):  # its reader has ended
                stream.flush()
        pid = os.fork()
        if not pid:
            self._work(index, ring, pipe, (self._control.fileno(), *self.children))
        return pid

    def _work(self, index: int, ring: str, pipe: int, foreign: Iterable[int]) -> NoReturn:
        """Be the worker, and end the process: what lies below on its stack is the fork server's.

        `foreign`: file descriptors that must be open in the fork server alone, so that its end is noticed.
        """
        code = 1
        try:
            from vaoi_station.runs.workers.worker import run_worker

            for descriptor in foreign:
                os.close(descriptor)
            name = f"vaoi-worker-{index}"
            multiprocessing.current_process().name = name
            set_process_title(name, arguments=True)
            run_worker(Connection(pipe), ring, index, self._logs, self._workers)
            code = 0
        except Exception:  # noqa: BLE001  any error ends the worker, which the pool replaces
            _log.critical("the worker has ended", exc_info=True)
        finally:
            with suppress(OSError):
                sys.stdout.flush()
            os._exit(code)


def _other_threads() -> list[str]:
    """Return the names of all threads of this process but the main one, also of those that libraries have started."""
    names = []
    for thread in Path("/proc/self/task").iterdir():
        with suppress(OSError):  # it has ended just now
            if int(thread.name) != os.getpid():
                names.append((thread / "comm").read_text().strip())
    return names
