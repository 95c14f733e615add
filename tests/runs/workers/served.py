"""A fork server and the workers that a test requests of it."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from vaoi_station.runs.host.message_pipe import wait_for
from vaoi_station.runs.workers.fork_server_link import ChildProcess, ForkServerLink, Outcome

PATIENCE_S = 240.0


@contextmanager
def few_files(pid: int, room: int) -> Iterator[None]:
    """Let a process open only this number of further files while the context lasts."""
    before = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    used = {int(path.name) for path in Path(f"/proc/{pid}/fd").iterdir()}
    # The limit is that of the number of a file, and the lowest free numbers are used first.
    free = [number for number in range(len(used) + room + 1) if number not in used]
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (free[room], before[1]))
    try:
        yield
    finally:
        resource.prlimit(pid, resource.RLIMIT_NOFILE, before)


class Served:
    """Calls the link as the pool does, until what a test awaits has come true."""

    def __init__(self) -> None:
        self.reports: list[str] = []
        """Sentences about fork servers that have ended."""
        self.outcomes: list[Outcome] = []
        self.link = ForkServerLink(self.reports.append, 2)

    def __enter__(self) -> Served:
        self.until(lambda: self.link.ready)
        return self

    def __exit__(self, *_: object) -> None:
        self.link.stop()

    @property
    def pid(self) -> int:
        pid = self.link.status().pid
        assert pid is not None
        return pid

    def until(self, true: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while not true():
            assert time.monotonic() < deadline_s, self.reports
            wait_for([], self.link.descriptors(), self.link.pause_s())
            self.outcomes += self.link.outcomes()

    def requested(self, ring: str, index: int = 0) -> tuple[ChildProcess | str, Connection[Any, Any]]:
        """Request a worker, and return what became of it, and the station's end of its pipe."""
        here, there = Pipe()
        self.outcomes.clear()
        with there:
            self.link.request(index, ring, there.fileno())
        self.until(lambda: bool(self.outcomes))
        [(answered, outcome)] = self.outcomes
        assert answered == index
        return outcome, here

    def started(self, ring: str, index: int = 0) -> tuple[ChildProcess, Connection[Any, Any]]:
        """Start a worker, and return its process and the station's end of its pipe."""
        outcome, pipe = self.requested(ring, index)
        assert isinstance(outcome, ChildProcess), outcome
        return outcome, pipe

    def code(self, worker: ChildProcess) -> int | None:
        """Return the exit code of a worker once it is known."""
        assert worker.has_ended(PATIENCE_S)
        self.until(lambda: not self.link.will_report(worker))
        return worker.exit_code
