"""The fork server: it imports and warms up once, and then forks each worker that the station requests.

A worker that is forked has all modules and all machine code at once, and shares their memory with the others. A process
that forks must have one thread only: a lock that another thread holds would stay locked in the child for ever.
"""

from __future__ import annotations

import gc
import logging
import multiprocessing
import os
import signal
import socket
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import NoReturn

from vaoi_station.runs.host.process_setup import set_up_process
from vaoi_station.runs.host.process_title import set_process_title
from vaoi_station.runs.workers.forking.messages import (
    Fork,
    Forked,
    NotForked,
    Ping,
    ServerReady,
    ServerStarting,
    WorkerEnded,
    receive,
    send,
)

_log = logging.getLogger(__name__)

PROGRESS_S = 1.0
"""Time between two reports of the progress of the warm-up."""


def run_fork_server(control: socket.socket) -> None:
    """Warm up, and fork workers until the station closes the socket. End after the last worker has ended."""
    set_up_process(one_thread=True)
    # Automatic collections are off, because a full collection would delay a result, and scan what is imported again and
    # again. Workers collect after a run was closed and while they are idle.
    gc.disable()
    # These imports come after the set-up: OpenBLAS and OpenMP read the number of threads from the environment when they
    # are loaded.
    import cv2

    from vaoi_station.runs.workers.forking.second_compiler import second_compiler
    from vaoi_station.runs.workers.warmup import warm_up
    from vaoi_station.runs.workers.worker_process import run_worker  # noqa: F401  for the workers: see `_work`

    # OpenCV starts one thread per core by default. Such threads would slow down other workers, and this process could
    # not fork.
    cv2.setNumThreads(1)
    children: dict[int, int] = {}
    # The station may end without a message. This process must not continue without it.
    with control, suppress(ConnectionError):
        with _progress_sent(control), second_compiler():
            warm_up()
        # Imported and compiled objects are never freed: `freeze` excludes them from collections, which would write to
        # the memory that all workers share.
        gc.collect()
        gc.freeze()
        send(control, ServerReady())
        _serve(control, children)
    for pid in children.values():
        os.waitpid(pid, 0)


@contextmanager
def _progress_sent(control: socket.socket) -> Iterator[None]:
    """Report the progress of the warm-up while the context lasts."""
    from vaoi_station.compiled import progress

    def report(*_: object) -> None:
        with suppress(OSError):  # The station has ended. This is noticed at the end of the warm-up.
            send(control, ServerStarting(*progress()))

    # A timer, because a thread may exist in the kernel for some time after it was joined.
    signal.signal(signal.SIGALRM, report)
    signal.setitimer(signal.ITIMER_REAL, PROGRESS_S, PROGRESS_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)


def _serve(control: socket.socket, children: dict[int, int]) -> None:
    """Fork workers and report their ends. `children` has the pid of each worker that runs, by its pidfd."""
    while True:
        ready = wait([control, *children])
        for pidfd in children.keys() & set(ready):
            pid = children.pop(pidfd)
            os.close(pidfd)
            send(control, WorkerEnded(pid, os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])))
        if control not in ready:
            continue
        if (received := receive(control)) is None:
            return
        match received:
            case Ping(), _:
                send(control, ServerReady())
            case Fork() as request, [pipe]:
                outcome, descriptors = _started(request, pipe, control, children)
                # Before the report, so that the worker alone has its end of the pipe when it is reported.
                os.close(pipe)
                send(control, outcome, descriptors)
            case Fork() as request, _:
                send(control, NotForked(request.index, "the fork server has too many open files"))


def _started(
    request: Fork, pipe: int, control: socket.socket, children: dict[int, int]
) -> tuple[Forked | NotForked, list[int]]:
    """Fork a worker, and return the report of it with its pidfd, or of why there is none."""
    try:
        pid = _forked(request, pipe, control, children)
        try:
            pidfd = os.pidfd_open(pid)
        except OSError:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            raise
    except OSError as fault:
        # There is too little memory, or there are too many processes or files. This may pass.
        return NotForked(request.index, str(fault)), []
    children[pidfd] = pid
    return Forked(request.index, pid), [pidfd]


def _forked(request: Fork, pipe: int, control: socket.socket, children: Iterable[int]) -> int:
    """Fork a worker, and return its pid. In the worker, this function does not return.

    Raises:
        OSError: the computer has too little memory or too many processes, or this process has several threads.
    """
    if others := _other_threads():
        raise OSError(f"the fork server has other threads: {', '.join(others)}")
    # A child process would write once more what its parent has not written yet.
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):  # its reader has ended
            stream.flush()
    pid = os.fork()
    if not pid:
        _work(request, pipe, (control.fileno(), *children))
    return pid


def _other_threads() -> list[str]:
    """Return the names of all threads of this process but the main one, also of those that libraries have started."""
    names = []
    for thread in Path("/proc/self/task").iterdir():
        with suppress(OSError):  # it has ended just now
            if int(thread.name) != os.getpid():
                names.append((thread / "comm").read_text().strip())
    return names


def _work(request: Fork, pipe: int, foreign: Iterable[int]) -> NoReturn:
    """Be the worker, and end the process: what lies below on its stack is the fork server's.

    `foreign`: file descriptors that must be open in the fork server alone, so that its end is noticed.
    """
    code = 1
    try:
        from vaoi_station.runs.workers.worker_process import run_worker

        for descriptor in foreign:
            os.close(descriptor)
        name = f"vaoi-worker-{request.index}"
        multiprocessing.current_process().name = name
        set_process_title(name, arguments=True)
        run_worker(Connection(pipe), request.ring)
        code = 0
    except Exception:  # noqa: BLE001  any error ends the worker, which the pool replaces
        _log.critical("the worker has ended", exc_info=True)
    finally:
        with suppress(OSError):
            sys.stdout.flush()
        os._exit(code)
