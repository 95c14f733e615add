"""The file of the database: open, check and migrate it.

Set it aside if it is damaged; copy it back if it was deleted.
"""

from __future__ import annotations

import contextlib
import sqlite3
import stat
import time
from pathlib import Path
from typing import NamedTuple

from vaoi_station.errors import InputError
from vaoi_station.store.schema import migrate
from vaoi_station.store.start_check import check_at_start
from vaoi_station.store.storage_trouble import (
    DAMAGED,
    DELETED,
    UNAVAILABLE,
    StorageTrouble,
    translated_errors,
    trouble_of,
)

_COMPANIONS = ("", "-wal", "-shm")
"""Endings of the three files that together are one database."""
_HEADER_BYTES = 100
MARK = ".begun"
"""Ending of an empty marker file. If it is absent, a start without a database is the first start."""


class Identity(NamedTuple):
    """Device number and inode of a file. A path whose file was deleted or replaced has another identity."""

    device: int
    inode: int


def identity_of(path: Path) -> Identity | None:
    """Return the identity of the file at a path; None if there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return Identity(found.st_dev, found.st_ino)


def open_database(path: Path) -> tuple[sqlite3.Connection, StorageTrouble | None]:
    """Open the writing connection. Create the file or migrate it; set a damaged one aside and begin an empty one.

    Returns: The connection, and a trouble that states what was wrong and what was done; None if nothing was wrong.

    Raises:
        InputError: the database was written by a newer version, or by another program.
        DeviceError: it cannot be used at present; the code says why.
    """
    with translated_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        notice = _deleted(path)
    try:
        connection = _open(path)
    except sqlite3.DatabaseError as error:
        trouble = trouble_of(error, path)
        if trouble is None or trouble.code != DAMAGED:
            with translated_errors(path):
                raise
        with translated_errors(path):
            notice = set_aside(path, str(error))
            connection = _open(path)
    except OSError:
        with translated_errors(path):
            raise
    with translated_errors(path):
        path.with_name(path.name + MARK).touch()
    return connection, notice


def set_aside(path: Path, why: str) -> StorageTrouble:
    """Rename a damaged database, so that the next one begins empty and the old one can still be recovered."""
    # The time is only a part of a name here; a second set of files within the same second gets a number.
    stem = f"{path.name}.damaged-{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}"
    kept = next(p for n in range(1000) if not (p := path.with_name(stem if n == 0 else f"{stem}-{n}")).exists())
    for ending in _COMPANIONS:
        with contextlib.suppress(FileNotFoundError):
            path.with_name(path.name + ending).rename(kept.with_name(kept.name + ending))
    return StorageTrouble(
        DAMAGED,
        f"{path}: was damaged ({why}); it was set aside as {kept.name}, and the history begins anew.",
        f"Recover {kept.name} with the command sqlite3 (.recover) or restore a backup; check the disk.",
    )


def connect(path: Path) -> sqlite3.Connection:
    """Open a connection whose transactions are begun and ended by the caller."""
    # isolation_level=None leaves BEGIN and COMMIT to the caller; readers are passed between threads, one at a time.
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=10)
    connection.row_factory = sqlite3.Row
    connection.execute("PRAGMA foreign_keys = ON")
    return connection


def roll_back(connection: sqlite3.Connection) -> None:
    """End a transaction that has failed, if SQLite has not done so itself."""
    # After "disk full" and most I/O errors, SQLite has rolled back already. A second ROLLBACK would fail with "cannot
    # rollback - no transaction is active", which would hide the cause.
    if connection.in_transaction:
        with contextlib.suppress(sqlite3.Error):
            connection.execute("ROLLBACK")


def _deleted(path: Path) -> StorageTrouble | None:
    """Return a trouble if there was a database at an earlier start, and now there is none or an empty file."""
    # SQLite takes a file that is shorter than its header for a new database.
    size = path.stat().st_size if path.exists() else 0
    if size >= _HEADER_BYTES or not path.with_name(path.name + MARK).exists():
        return None
    return StorageTrouble(
        DELETED,
        f"{path}: the database of earlier starts is not there any more; the history begins anew.",
        "Restore it from a backup while the station is stopped, if it was not deleted on purpose.",
    )


def _open(path: Path) -> sqlite3.Connection:
    # SQLite would wait for ever at a FIFO, and its error for a folder does not state the cause.
    if path.exists() and not stat.S_ISREG(path.stat().st_mode):
        raise StorageTrouble(
            UNAVAILABLE, f"{path}: cannot be used, because it is not a regular file.", "Move it away."
        ).error()
    connection = connect(path)
    try:
        _refuse_foreign(connection, path)
        connection.execute("PRAGMA journal_mode = WAL")
        # A write-ahead log with NORMAL survives a crash of the process; `Database` waits for the disk (FULL) with the
        # writes that must survive a power failure too (SQLite documentation, "PRAGMA synchronous").
        connection.execute("PRAGMA synchronous = NORMAL")
        # If damage is found here, only the history is lost. If it were found later, a result would be lost as well.
        check_at_start(connection, path)
        migrate(connection, path)
    except BaseException:  # close in every case, then raise the error again
        with contextlib.suppress(sqlite3.Error):
            connection.close()
        raise
    return connection


def _refuse_foreign(connection: sqlite3.Connection, path: Path) -> None:
    """Raise InputError if another program has made the database. The file is not changed."""
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if ("runs" in tables) != (version > 0) or (version == 0 and tables):
        raise InputError(
            f"{path}: is a database of another program (tables {', '.join(sorted(tables)[:5]) or 'none'}).",
            action="Move it away, or give the station another data directory.",
            code="database-foreign",
        )
