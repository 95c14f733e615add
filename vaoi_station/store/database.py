"""One SQLite file: one writer thread, readers that never wait for it (write-ahead log)."""

from __future__ import annotations

import contextlib
import sqlite3
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar

from vaoi_station.errors import DeviceError, InternalError, StateError
from vaoi_station.store.schema import migrate

T = TypeVar("T")
READERS = 4

Write = Callable[[sqlite3.Connection], Any]


class Database:
    """An open database; `write` is carried out in order by one thread, `read` by whoever calls."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._writer = _open(path)
        self._readers: SimpleQueue[sqlite3.Connection] = SimpleQueue()
        for _ in range(READERS):
            self._readers.put(_connect(path))
        self._jobs: SimpleQueue[tuple[Write, Future[Any]] | None] = SimpleQueue()
        self._closed = False
        self._gate = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="store", daemon=True)
        self._thread.start()

    def write(self, work: Callable[[sqlite3.Connection], T]) -> Future[T]:
        """Carry out `work` in one transaction, after all writes asked for before; done when it is on disk."""
        future: Future[T] = Future()
        with self._gate:
            if self._closed:
                raise StateError(f"{self.path}: is closed; the station is stopping.")
            self._jobs.put((work, future))
        return future

    def read(self, query: str, values: tuple[Any, ...] = ()) -> list[sqlite3.Row]:
        """Rows of a query, as of the last finished write."""
        with self._reader() as connection, _told(self.path):
            return connection.execute(query, values).fetchall()

    def close(self) -> None:
        """Finish all writes and close the file; harmless when closed."""
        with self._gate:
            if self._closed:
                return
            self._closed = True
            self._jobs.put(None)
        self._thread.join()
        for _ in range(READERS):
            self._readers.get().close()
        self._writer.close()

    @contextlib.contextmanager
    def _reader(self) -> Iterator[sqlite3.Connection]:
        if self._closed:
            raise StateError(f"{self.path}: is closed; the station is stopping.")
        connection = self._readers.get()
        try:
            yield connection
        finally:
            self._readers.put(connection)

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            work, future = job
            try:
                with _told(self.path):
                    self._writer.execute("BEGIN IMMEDIATE")
                    try:
                        result = work(self._writer)
                        self._writer.execute("COMMIT")
                    except BaseException:  # whatever ended it, tidy up; it is raised again
                        self._writer.execute("ROLLBACK")
                        raise
            except Exception as error:  # noqa: BLE001  whoever asked for the write is told; the next one may succeed
                future.set_exception(error)
            else:
                future.set_result(result)


def _open(path: Path) -> sqlite3.Connection:
    """A writing connection to a sound, up-to-date database; made if there is none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with _told(path):
        connection = _connect(path)
    try:
        with _told(path):
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = NORMAL")
            fault = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
            if fault != "ok":
                raise sqlite3.DatabaseError(fault)
            migrate(connection, path)
    except BaseException:  # whatever ended it, tidy up; it is raised again
        connection.close()
        raise
    return connection


def _connect(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=10)
    connection.row_factory = sqlite3.Row
    connection.execute("PRAGMA foreign_keys = ON")
    return connection


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    """SQLite's errors as ours: what the file suffers from, and what to do."""
    try:
        yield
    except sqlite3.OperationalError as error:
        raise DeviceError(
            f"{path}: cannot be used ({error}).", action="Check space and permissions of the data directory."
        ) from error
    except sqlite3.IntegrityError as error:
        raise InternalError(f"{path}: refused a write ({error}).") from error
    except sqlite3.DatabaseError as error:
        raise DeviceError(
            f"{path}: is not a sound database ({error}).",
            action="Restore it from a backup, or move it away; the station then begins with an empty one.",
            code="database-damaged",
        ) from error
