"""The process that adds runs to an archive. It waits for the station before every access to the archive.

It is a process, not a thread of the station: a thread of the lowest priority that compiles or encodes could hold the
interpreter's lock for as long as others use the processor, and the station would wait for it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing import Pipe, current_process
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from vaoi_station.child_environment import child_environment
from vaoi_station.errors import DeviceError, InputError, StateError, VaoiError
from vaoi_station.plant.storage import Entry, Storage
from vaoi_station.runs.host.processes import set_up_process

LOWEST_PRIORITY = 19


class Addition(NamedTuple):
    """A run that is to be added. It is answered by `Turn`s, then by `Added` or `Failed`."""

    url: str
    folder: Path
    station: str


class Turn(NamedTuple):
    """The adder is about to write `size` bytes, or to read. It goes on when the station has sent True."""

    size: int


class Added(NamedTuple):
    """The run is in the archive; `bytes` is its size there."""

    bytes: int


class Failed(NamedTuple):
    """The run could not be added."""

    error: VaoiError
    of_run: bool
    """Whether the run is at fault, and not the archive."""


def launch_adder() -> tuple[Connection[Any, Any], subprocess.Popen[bytes]]:
    """Start the process, and return the pipe to it.

    It is none of `multiprocessing`, which waits at the end of a program for each of its processes: one that a share
    blocks ends only when the share answers, and would keep the station from ending.
    """
    ours, its = Pipe()
    command = [sys.executable, "-P", "-c", f"from {__name__} import main; main({its.fileno()})"]
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, pass_fds=(its.fileno(),), env=child_environment()
    )  # fmt: skip
    its.close()
    return ours, process


def main(connection: int) -> None:
    """Run the process with its end of the pipe, a file descriptor, until the station closes the pipe."""
    current_process().name = "vaoi-archive"
    set_up_process(one_thread=True)
    os.setpriority(os.PRIO_PROCESS, 0, LOWEST_PRIORITY)
    serve(Connection(connection))


def serve(connection: Connection[Any, Any]) -> None:
    """Add runs until the other side closes the pipe."""
    try:
        while True:
            connection.send(_add(connection, connection.recv()))
    except (EOFError, OSError):
        return  # The station has ended, or has given the run up.


def _add(connection: Connection[Any, Any], wanted: Addition) -> Added | Failed:
    from vaoi_station.plant.archive import Archive

    def take_turn(size: int) -> None:
        connection.send(Turn(size))
        connection.recv()

    try:
        archive = Archive(PacedStorage(Archive.open(wanted.url).storage, take_turn))
    except VaoiError as error:
        return Failed(error, of_run=False)
    try:
        return Added(archive.add(wanted.folder, station=wanted.station).bytes)
    except VaoiError as error:
        return Failed(error, of_run=not isinstance(error, DeviceError | StateError))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        raise
    except Exception as error:  # noqa: BLE001  the process must go on: it adds later runs
        cause = InputError(f"{type(error).__name__}: {error}.", action="Report it to the maintainer.")
        return Failed(cause, of_run=True)


@dataclass(frozen=True)
class PacedStorage:
    """Passes everything on to another storage, after a call of `pace` with the number of bytes that are to be written.

    Exceptions of `pace` end what is under way; what was written stays.
    """

    storage: Storage
    pace: Callable[[int], None]

    @property
    def url(self) -> str:
        """Address of the storage."""
        return self.storage.url

    def read(self, key: str) -> bytes:
        """Return an object."""
        self.pace(0)
        return self.storage.read(key)

    def write(self, key: str, content: bytes) -> None:
        """Write an object."""
        self.pace(len(content))
        self.storage.write(key, content)

    def entry(self, key: str) -> Entry | None:
        """Return size and time of an object; None if it is absent."""
        self.pace(0)
        return self.storage.entry(key)

    def names(self, prefix: str) -> list[str]:
        """Return the names directly below a prefix."""
        self.pace(0)
        return self.storage.names(prefix)

    def entries(self, prefix: str) -> Iterator[Entry]:
        """Yield all objects below a prefix."""
        self.pace(0)
        return self.storage.entries(prefix)

    def leftovers(self) -> Iterator[Entry]:
        """Yield the unfinished files of writers."""
        self.pace(0)
        return self.storage.leftovers()

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""
        self.pace(0)
        self.storage.delete(key)
