"""The main loop of a worker process: it receives messages and sends their replies until the station closes the pipe.

The fork server imports this module and forks, so that a worker has all modules and machine code from the beginning.
"""

from __future__ import annotations

import gc
from multiprocessing.connection import Connection
from typing import Any

from vaoi_station.runs.workers.jobs import CloseRun, Ping
from vaoi_station.runs.workers.worker_runtime import WorkerRuntime


def run_worker(connection: Connection[Any, Any], ring_path: str) -> None:
    """Perform jobs until the station sends None or closes the pipe."""
    with connection, WorkerRuntime(ring_path) as runtime:
        try:
            connection.send(runtime.ready())
            while (message := connection.recv()) is not None:
                # Each reply is sent before the next one is computed, so a result does not wait for its check.
                for reply in runtime.replies(message):
                    connection.send(reply)
                # Automatic collections are off; see `run_fork_server`.
                if isinstance(message, CloseRun | Ping):
                    gc.collect()
        except (EOFError, BrokenPipeError, ConnectionResetError):
            # The station has ended without a message. A worker must not continue without it.
            return
