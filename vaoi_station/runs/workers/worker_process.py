"""The main loop of a worker process: it receives messages and sends their replies until the station closes the pipe."""

from __future__ import annotations

import contextlib
import gc
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any

from vaoi_station.runs.host.process_setup import set_up_process

PROGRESS_S = 1.0
"""Time between two reports of the progress of the warm-up."""


def run_worker(connection: Connection[Any, Any], ring_path: str) -> None:
    """Perform jobs until the station sends None or closes the pipe."""
    set_up_process(one_thread=True)
    # Automatic collections are off, because a full collection would delay a result, and scan what is imported again and
    # again. Collections run below, after a run was closed and while the worker is idle.
    gc.disable()
    # These imports come after the set-up: OpenBLAS and OpenMP read the number of threads from the environment when they
    # are loaded.
    from vaoi_station.runs.workers.jobs import CloseRun, Ping
    from vaoi_station.runs.workers.warmup import warm_up
    from vaoi_station.runs.workers.worker_runtime import WorkerRuntime

    with connection, WorkerRuntime(ring_path) as runtime:
        try:
            with _progress_sent(connection):
                warm_up()
            # Imported and compiled objects are never freed: `freeze` excludes them from collections.
            gc.collect()
            gc.freeze()
            connection.send(runtime.ready())
            while (message := connection.recv()) is not None:
                # Each reply is sent before the next one is computed, so a result does not wait for its check.
                for reply in runtime.replies(message):
                    connection.send(reply)
                if isinstance(message, CloseRun | Ping):
                    gc.collect()
        except (EOFError, BrokenPipeError, ConnectionResetError):
            # The station has ended without a message. A worker must not continue without it.
            return


@contextmanager
def _progress_sent(connection: Connection[Any, Any]) -> Iterator[None]:
    """Report the progress of the warm-up from a thread while the context lasts.

    The context's end waits for the thread.
    """
    from vaoi_station.compiled import progress
    from vaoi_station.runs.workers.jobs import WorkerStarting

    ended = threading.Event()

    def send() -> None:
        # The station has ended. The main thread notices this when it reports that the worker is ready.
        with contextlib.suppress(OSError):
            while not ended.wait(PROGRESS_S):
                connection.send(WorkerStarting(*progress()))

    thread = threading.Thread(target=send, name="progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
