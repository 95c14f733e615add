"""The process of one worker: a job comes, an answer goes, until the pipe ends."""

from __future__ import annotations

import gc
from multiprocessing.connection import Connection
from typing import Any

from vaoi_station.runs.host.process_setup import set_up_process


def run_worker(connection: Connection[Any, Any], ring_path: str) -> None:
    """Do jobs until there are no more; heavy imports only after the number of threads is set."""
    set_up_process(one_thread=True)
    from vaoi_station.runs.workers.jobs import CloseRun, Ping
    from vaoi_station.runs.workers.warmup import warm_up
    from vaoi_station.runs.workers.worker_runtime import WorkerRuntime

    with connection, WorkerRuntime(ring_path) as bench:
        try:
            warm_up()
            gc.collect()
            gc.freeze()  # what was imported and compiled stays
            gc.disable()  # and nothing is looked through while a board waits
            connection.send(bench.hello())
            while (message := connection.recv()) is not None:
                if (answer := bench.take(message)) is not None:
                    connection.send(answer)
                if isinstance(message, CloseRun | Ping):
                    gc.collect()
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return  # the station is gone, and so is the reason to be here
