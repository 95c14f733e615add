"""The acquisition process as the coordinator sees it, played by a test."""

from __future__ import annotations

import multiprocessing
import threading
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from vaoi_station.acquisition.process import messages
from vaoi_station.runs.control.acquisition_link import AcquisitionLink, Process

R = TypeVar("R")
PATIENCE_S = 20.0


class FakeProcess:
    """Stands for a process: it ends when the test calls `die`."""

    def __init__(self) -> None:
        self._here, self._there = multiprocessing.Pipe(duplex=False)
        self._ended = threading.Event()
        self.pid = 4711
        self.exitcode: int | None = None

    @property
    def sentinel(self) -> int:
        return self._here.fileno()

    def kill(self) -> None:
        self.die(-9)

    def die(self, code: int) -> None:
        if self.exitcode is None:
            self.exitcode = code
            self._ended.set()
            self._there.close()

    def join(self, timeout: float | None = None) -> None:
        self._ended.wait(timeout)

    def close(self) -> None:
        self._here.close()


class Peer:
    """The acquisition process, played by the test."""

    def __init__(self) -> None:
        self.processes: list[tuple[FakeProcess, Connection[Any, Any]]] = []
        self._born = threading.Condition()
        self.grants: list[messages.Grant] = []

    def launch(self) -> tuple[Process, Connection[Any, Any]]:
        here, there = multiprocessing.Pipe()
        process = FakeProcess()
        with self._born:
            self.processes.append((process, there))
            self._born.notify_all()
        return process, here

    def wait_for_start(self, number: int) -> None:
        """Wait until the process was started `number` times."""
        with self._born:
            assert self._born.wait_for(lambda: len(self.processes) >= number, PATIENCE_S)

    @property
    def connection(self) -> Connection[Any, Any]:
        return self.processes[-1][1]

    def report(self, *reports: messages.Report) -> None:
        for report in reports:
            self.connection.send(report)

    def expect(self, kind: type[R]) -> R:
        assert self.connection.poll(PATIENCE_S), f"no {kind.__name__} came"
        command = self.connection.recv()
        assert isinstance(command, kind), command
        return command

    def die(self, code: int = -9) -> None:
        process, connection = self.processes[-1]
        connection.close()
        process.die(code)

    def close(self) -> None:
        for process, connection in self.processes:
            connection.close()
            process.die(0)


def end_link(link: AcquisitionLink, peer: Peer) -> None:
    """Stop a link whose scripted process does not read Shutdown: it ends when it is closed."""
    ending = threading.Thread(target=link.stop, args=(PATIENCE_S,))
    ending.start()
    peer.close()
    ending.join()
