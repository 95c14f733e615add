"""One SQLite file with one writer thread; readers never wait for the writer (write-ahead log).

A write that the disk refuses is tried again until it succeeds. All later writes wait until then, so that the order of
writes is kept. A damaged database is set aside, a deleted one is copied back, and writing continues.
"""

from __future__ import annotations

import contextlib
import logging
import os
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar

from vaoi_station.errors import DeviceError, NotFoundError, StateError
from vaoi_station.store.database_file import (
    BEAT_STEPS,
    acknowledged_files,
    connect,
    earlier_notices,
    identity_of,
    is_absent,
    is_empty,
    mark_acknowledged,
    open_database,
    rescue,
    roll_back,
    set_aside,
    stand_in,
)
from vaoi_station.store.schema import unpacked
from vaoi_station.store.storage_trouble import (
    DAMAGED,
    DELETED,
    FULL,
    UNAVAILABLE,
    StorageTrouble,
    translated,
    translated_errors,
    trouble_of,
)
from vaoi_station.supervised_thread import SupervisedThread

_log = logging.getLogger(__name__)
T = TypeVar("T")
READERS = 4
"""Number of connections for reading; further simultaneous readers wait."""
READER_CACHE_KIB = 256
"""Pages that each of these connections holds in memory. A query that reads many rows fills it in the heap of its own
thread; the pages are in the kernel's cache anyway."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.25, 2.0
"""Pauses before a refused write is tried again; each pause is twice the one before."""
CHECK_S = 2.0
"""Time between two checks of the file while nothing is written."""
WRITE_LIMIT_S = 600.0
"""Longest time without progress of a write, s. After it, the writing thread counts as hung."""
SLOW_S = 5.0
"""Time, s, after which a write that has not ended counts as trouble."""
MOST_WAITING_BYTES = 64_000_000
"""Largest total size of the writes that wait for the disk, bytes. Further writes are refused."""


@dataclass(frozen=True, eq=False)
class _Job:
    work: Callable[[sqlite3.Connection], Any]
    future: Future[Any]
    patient: bool
    durable: bool
    size: int


class Database:
    """An open database. One thread carries out all writes in order; reads run in the calling thread."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._writer: sqlite3.Connection | None
        self._trouble: StorageTrouble | None = None
        self.notices = earlier_notices(path)
        """Notices that the database was damaged, deleted or replaced; each stays until its file is cleared away."""
        readers = self._open()
        self.acknowledged = acknowledged_files(path)
        """Files that were set aside and of which a person knows; their notices stay, but are no warnings."""
        self.history_unread = is_empty(readers[0])
        """Whether the station began without a database because the disk was full; an older one may appear later."""
        self.free_bytes: int | None = None
        """Free space for the database at the last check, bytes; None if it is not known."""
        self._opened_file: tuple[int, int] | None = None
        self._remember_file()
        self._measure_space()
        self._readers: SimpleQueue[sqlite3.Connection | None] = SimpleQueue()
        for reader in readers:
            self._readers.put(reader)
        self._jobs: deque[_Job] = deque()
        self._waiting_bytes = 0
        self._began_s: float | None = None
        self._closed = False
        self._changed = threading.Condition()
        self.thread = SupervisedThread(self._run, "store", WRITE_LIMIT_S)
        self.thread.start()

    def _open(self) -> list[sqlite3.Connection]:
        """Open the file, or stand-ins that can only be read while the disk takes no writes; return the readers."""
        try:
            self._writer, notice = open_database(self.path)
            self.notices += () if notice is None else (notice,)
            with translated_errors(self.path):
                return [connect(self.path, READER_CACHE_KIB) for _ in range(READERS)]
        except DeviceError as error:
            trouble = trouble_of(error, self.path)
            readers = None if trouble is None else stand_in(self.path, trouble, READERS)
            if readers is None:
                raise
            _log.warning("%s: the station begins without writing (%s)", self.path, error.message)
            self._writer, self._trouble = None, trouble
            return readers

    @property
    def trouble(self) -> StorageTrouble | None:
        """The trouble that prevents writing to the database at present; None if writes succeed."""
        # Read without the lock: both are replaced as a whole, and the station reads them several times a second.
        began_s = self._began_s
        if self._trouble is None and began_s is not None and time.monotonic() - began_s > SLOW_S:
            waited = f"{time.monotonic() - began_s:.0f} s"
            return StorageTrouble(UNAVAILABLE, f"{self.path}: a write has not ended for {waited}.", "Check the disk.")
        return self._trouble

    def write(
        self, work: Callable[[sqlite3.Connection], T], *, patient: bool = False, durable: bool = True, size: int = 0
    ) -> Future[T]:
        """Run `work` in one transaction, after all writes that were submitted before; again after a storage trouble.

        Args:
            work: the statements.
            patient: wait until the storage accepts the write. Otherwise a trouble of the storage is an error at once.
            durable: end only when the transaction, with all before it, survives a power failure.
            size: bytes that wait in memory with `work`.

        Raises:
            StateError: the database is closed. All other errors are set on the future.
        """
        future: Future[T] = Future()
        refused: StorageTrouble | None = None
        # The lock separates writes from `close`: a write that is queued after the end would never be carried out.
        with self._changed:
            self._refuse_closed()
            if not patient and self._trouble is not None:
                refused = self._trouble
            elif patient and self._waiting_bytes + size > MOST_WAITING_BYTES:
                why = self._trouble.message if self._trouble else "The disk is too slow."
                message = f"{why} More than {MOST_WAITING_BYTES / 1e6:.0f} MB wait in memory."
                refused = StorageTrouble(FULL, message, "Free space in the data directory.")
            else:
                self._jobs.append(_Job(work, future, patient, durable, size))
                self._waiting_bytes += size
                self._changed.notify_all()
        # This happens outside the lock, because callbacks of the future may write too.
        if refused is not None:
            future.set_exception(refused.error())
        return future

    def read(self, query: str, values: tuple[Any, ...] = ()) -> list[sqlite3.Row]:
        """Return the rows of a query, as of the last completed write."""
        try:
            with self._reader() as connection:
                return connection.execute(query, values).fetchall()
        except sqlite3.Error as error:
            if (trouble := trouble_of(error, self.path)) is not None and trouble.code == DAMAGED:
                with contextlib.suppress(StateError):
                    self.write(self._check, durable=False)
            raise translated(error, self.path) from error

    def value(self, query: str, values: tuple[Any, ...] = ()) -> Any:
        """Return the first column of the first row of a query; None without a row."""
        rows = self.read(query, values)
        return rows[0][0] if rows else None

    def column(self, query: str, values: tuple[Any, ...] = ()) -> list[str]:
        """Return the first column of all rows of a query."""
        return [str(row[0]) for row in self.read(query, values)]

    def text(self, query: str, values: tuple[Any, ...] = ()) -> str | None:
        """Return the text that a query selects as a column and its packed column; None without a row."""
        with translated_errors(self.path):
            rows = self.read(query, values)
            return unpacked(*rows[0]) if rows else None

    def execute(
        self,
        statement: str,
        values: tuple[Any, ...] = (),
        *,
        patient: bool = False,
        durable: bool = True,
        size: int = 0,
    ) -> Future[int]:
        """Run one statement as `write` does; the future has the number of rows that it changed."""
        return self.write(
            lambda connection: connection.execute(statement, values).rowcount,
            patient=patient, durable=durable, size=size,
        )  # fmt: skip

    def close(self) -> None:
        """Finish all writes and close the file, if it is open. Writes that the disk refuses now are lost."""
        with self._changed:
            if self._closed:
                return
            self._closed = True
            self.thread.expect_end()
            self._changed.notify_all()
        self.thread.join()
        self._close_connections()

    def _refuse_closed(self) -> None:
        if self._closed:
            raise StateError(f"{self.path}: is closed; the station is stopping.")

    @contextlib.contextmanager
    def _reader(self) -> Iterator[sqlite3.Connection]:
        self._refuse_closed()
        connection = self._readers.get()
        try:
            if connection is None:
                self._refuse_closed()
                raise (self._trouble or StorageTrouble(UNAVAILABLE, f"{self.path}: is not open.")).error()
            yield connection
        finally:
            self._readers.put(connection)

    def _run(self) -> None:
        while (job := self._next()) is not None:
            self._perform(job)

    def _next(self) -> _Job | None:
        """Return the next write; None if the database was closed and all writes are done. Meanwhile, check the file."""
        while True:
            self.thread.beat()
            with self._changed:
                if not self._jobs and not self._closed:
                    self._changed.wait(LONGEST_PAUSE_S if self._trouble else CHECK_S)
                if self._jobs:
                    job = self._jobs.popleft()
                    self._waiting_bytes -= job.size
                    return job
                if self._closed:
                    return None
            self._check_file()

    def acknowledge(self, name: str) -> None:
        """Record that a person knows of the file with this name that was set aside; NotFoundError: there is none."""
        kept = next((n.kept for n in self.notices if n.kept is not None and n.kept.name == name), None)
        if kept is None:
            raise NotFoundError(
                f"{name!r} is no database that was set aside.",
                action="See set_aside of GET station.",
                code="not-set-aside",
            )
        mark_acknowledged(kept)
        with self._changed:
            self.acknowledged |= {kept}

    def _check_file(self) -> None:
        """Notice a deleted file without waiting for a write, and check whether a past trouble is over."""
        self._began_s = time.monotonic()
        self._measure_space()
        self._began_s = None
        # A person who has recovered or given up what was set aside moves it away.
        self.notices = tuple(n for n in self.notices if n.kept is None or not is_absent(n.kept))
        if self._trouble is not None or self._file_changed():
            self._perform(_Job(_touch, Future(), patient=False, durable=True, size=0))

    def _file_changed(self) -> bool:
        """Return whether the file was deleted or replaced, so that the connection writes to a file without a name."""
        try:  # A directory that cannot be read proves neither: the next write shows whether the file can be used.
            return identity_of(self.path) != self._opened_file
        except OSError:
            return False

    def _remember_file(self) -> None:
        """Take the file that is at the path now as the one that is open."""
        self._opened_file = None
        with contextlib.suppress(OSError):
            self._opened_file = identity_of(self.path)

    def _measure_space(self) -> None:
        # The last value is kept after an error: if the mount was lost, the next write shows it.
        with contextlib.suppress(OSError):
            found = os.statvfs(self.path.parent)
            self.free_bytes = found.f_bavail * found.f_frsize

    def _perform(self, job: _Job) -> None:
        """Carry out one write. If the storage refuses it, try again as long as the write is patient."""
        pause_s = FIRST_PAUSE_S
        while True:
            self.thread.beat()
            try:
                self._began_s = time.monotonic()
                result = self._transaction(job)
            except Exception as error:  # noqa: BLE001  the caller gets the error through the future; the thread goes on
                self._began_s = None
                trouble = trouble_of(error, self.path)
                if trouble is None:
                    job.future.set_exception(
                        translated(error, self.path) if isinstance(error, sqlite3.Error) else error
                    )
                    return
                if trouble.code == DAMAGED and self._begin_anew(str(error)):
                    continue
                self._enter(trouble)
                if not job.patient or self._closed:
                    job.future.set_exception(trouble.error())
                    return
                with self._changed:
                    if not self._closed:
                        self._changed.wait(pause_s)
                pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
            else:
                self._began_s = None
                if self._trouble is not None:
                    _log.info("%s: is written again", self.path)
                self._trouble = None
                job.future.set_result(result)
                return

    def _transaction(self, job: _Job) -> Any:
        if self._file_changed():
            self._follow_file()
        if self._writer is None:
            self._reopen()
        assert self._writer is not None
        writer = self._writer
        # FULL waits until the write-ahead log is on the disk, including all transactions before this one.
        writer.execute(f"PRAGMA synchronous = {'FULL' if job.durable else 'NORMAL'}")
        # IMMEDIATE takes the write lock at once; a deferred transaction could fail with SQLITE_BUSY in the middle,
        # where the busy time-out does not apply.
        writer.execute("BEGIN IMMEDIATE")
        try:
            result = job.work(writer)
            writer.execute("COMMIT")
        except BaseException:  # roll back in every case, then raise the error again
            roll_back(writer)
            raise
        return result

    def _enter(self, trouble: StorageTrouble) -> None:
        """Record a trouble, and refuse the writes that do not wait until it is over."""
        with self._changed:
            if self._trouble is None or self._trouble.code != trouble.code:
                _log.warning("%s", trouble.message)
            self._trouble = trouble
            refused = [job for job in self._jobs if not job.patient]
            self._jobs = deque(job for job in self._jobs if job.patient)
            self._waiting_bytes = sum(job.size for job in self._jobs)
        for job in refused:
            job.future.set_exception(trouble.error())

    def _begin_anew(self, why: str) -> bool:
        """Set the damaged file aside and open an empty one; return False if that is not possible yet."""
        try:
            # No connection may be open: the last one that closes deletes the write-ahead log by its name.
            self._close_connections()
            notice = set_aside(self.path, why)
            self._remember_file()
            self._reopen()
        except Exception as error:  # noqa: BLE001  tried again with the next write; the log has the cause
            _log.warning("%s: cannot be opened again: %s", self.path, error)
            return False
        self.notices = (*self.notices, notice)
        _log.error("%s", notice.message)
        return True

    def _follow_file(self) -> None:
        """Write back a deleted database from the connection that still has it; open one that was put in its place."""
        if self._writer is None:
            return
        notice = rescue(self._writer, self.path, self.thread.beat)
        self._close_connections()
        self._remember_file()
        self._reopen()
        self.notices = (*self.notices, notice)
        _log.error("%s", notice.message)

    def _reopen(self) -> None:
        self._writer, notice = open_database(self.path)
        self._remember_file()
        # A notice that the file is absent adds no information to the notice that has led here.
        if notice is not None and notice.code != DELETED:
            self.notices = (*self.notices, notice)
        self._replace_readers([connect(self.path, READER_CACHE_KIB) for _ in range(READERS)])

    def _close_connections(self) -> None:
        self._replace_readers([None] * READERS)
        if self._writer is not None:
            with contextlib.suppress(sqlite3.Error):
                self._writer.close()
        self._writer = None

    def _replace_readers(self, connections: Sequence[sqlite3.Connection | None]) -> None:
        """Replace the connections for reading. Where the new connection is None, reads are refused."""
        # Taking each connection from the queue waits for reads that are still under way.
        for connection in [self._readers.get() for _ in range(READERS)]:
            if connection is not None:
                with contextlib.suppress(sqlite3.Error):
                    connection.close()
        for new in connections:
            self._readers.put(new)

    def _check(self, _: sqlite3.Connection) -> None:
        """Check the whole file, because a read has found damage."""
        # A new connection is used: the writer's own connection may have undamaged pages in its cache.
        with contextlib.closing(connect(self.path)) as fresh:
            fresh.set_progress_handler(self.thread.beat, BEAT_STEPS)
            fault = fresh.execute("PRAGMA quick_check(1)").fetchone()[0]
        if fault != "ok":
            raise sqlite3.DatabaseError(fault)


def _touch(connection: sqlite3.Connection) -> None:
    """Write to the database without changing its content."""
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    connection.execute(f"PRAGMA user_version = {int(version)}")
