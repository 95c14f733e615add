"""One SQLite file with one writer thread; readers never wait for the writer (write-ahead log)."""

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
from vaoi_station.store.start_check import check_at_start

T = TypeVar("T")
READERS = 4
"""Number of connections for reading. Further simultaneous readers wait until a connection is free."""

Write = Callable[[sqlite3.Connection], Any]


class Database:
    """An open database. One thread carries out all writes in order; reads run in the calling thread."""

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
        """Run `work` in one transaction, after all writes that were submitted before.

        Raises:
            StateError: the database is closed. Errors of `work` are set on the future.
        """
        future: Future[T] = Future()
        # The lock keeps writes and `close` apart: a write queued behind the end marker would never be carried out.
        with self._gate:
            if self._closed:
                raise StateError(f"{self.path}: is closed; the station is stopping.")
            self._jobs.put((work, future))
        return future

    def read(self, query: str, values: tuple[Any, ...] = ()) -> list[sqlite3.Row]:
        """Return the rows of a query, as of the last completed write."""
        with self._reader() as connection, _translated_errors(self.path):
            return connection.execute(query, values).fetchall()

    def close(self) -> None:
        """Finish all writes and close the file; no effect if it is closed."""
        with self._gate:
            if self._closed:
                return
            self._closed = True
            self._jobs.put(None)
        self._thread.join()
        # Taking each connection from the queue waits for reads that are still under way.
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
                with _translated_errors(self.path):
                    # IMMEDIATE takes the write lock at once; a deferred transaction could fail with SQLITE_BUSY in
                    # the middle, where the busy time-out does not apply.
                    self._writer.execute("BEGIN IMMEDIATE")
                    try:
                        result = work(self._writer)
                        self._writer.execute("COMMIT")
                    except BaseException:  # roll back or close in every case; the error is raised again
                        self._writer.execute("ROLLBACK")
                        raise
            except Exception as error:  # noqa: BLE001  the caller gets the error through the future; the thread goes on
                future.set_exception(error)
            else:
                future.set_result(result)


def _open(path: Path) -> sqlite3.Connection:
    """Open the writing connection; create the file or migrate it, and refuse a damaged one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with _translated_errors(path):
        connection = _connect(path)
    try:
        with _translated_errors(path):
            connection.execute("PRAGMA journal_mode = WAL")
            # With a write-ahead log NORMAL survives a crash of the process; a power failure may lose the last
            # transactions but does not damage the file (SQLite documentation, "PRAGMA synchronous").
            connection.execute("PRAGMA synchronous = NORMAL")
            # Damage found here stops the start, with an action for the operator. Found later, it would make a run fail.
            check_at_start(connection, path)
            migrate(connection, path)
    except BaseException:  # roll back or close in every case; the error is raised again
        connection.close()
        raise
    return connection


def _connect(path: Path) -> sqlite3.Connection:
    # isolation_level=None leaves BEGIN and COMMIT to `_run`; the readers are passed between threads, one at a time.
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=10)
    connection.row_factory = sqlite3.Row
    connection.execute("PRAGMA foreign_keys = ON")
    return connection


@contextlib.contextmanager
def _translated_errors(path: Path) -> Iterator[None]:
    """Convert SQLite errors to errors of the station, with the file's path and an action."""
    # OperationalError and IntegrityError are subclasses of DatabaseError, so the order of the clauses matters.
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
