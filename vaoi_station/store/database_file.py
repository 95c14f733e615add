"""The file of the database: open, check and migrate it.

Set it aside if it is damaged; copy it back if it was deleted. While the disk takes no writes, a start reads the file as
it is, or an empty history (`stand_in`).
"""

from __future__ import annotations

import contextlib
import sqlite3
import stat
import time
from collections.abc import Callable
from pathlib import Path

from vaoi_station.errors import InputError
from vaoi_station.files.directories import sync_directory
from vaoi_station.store.schema import VERSION, migrate
from vaoi_station.store.storage_trouble import (
    DAMAGED,
    DELETED,
    FULL,
    PASSING,
    REPLACED,
    UNAVAILABLE,
    StorageTrouble,
    translated_errors,
    trouble_of,
)

_COMPANIONS = ("", "-wal", "-shm")
"""Endings of the files that together are one database."""
HEADER_BYTES = 100
"""Size of the header of a database; SQLite takes a shorter file for a new one."""
LARGEST_AT_START = 50_000_000
"""Largest file in bytes that is checked completely at the start; measured, that takes a second from a cold disk."""
BEAT_STEPS = 10_000
"""Steps of SQLite's virtual machine between two heartbeats of a thread, some hundredths of a second."""
ACKNOWLEDGED = ".acknowledged"
"""Ending of an empty marker file beside a file that was set aside: a person knows of it, and the warning has ended."""
MARK = ".begun"
"""Ending of an empty marker file. If it is absent, a start without a database is the first start."""


def identity_of(path: Path) -> tuple[int, int] | None:
    """Return device and inode of a file, which differ once it was replaced; None: there is none. OSError: unknown."""
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    return found.st_dev, found.st_ino


def is_absent(path: Path) -> bool:
    """Return whether there is certainly no file at a path: a directory that cannot be read proves nothing."""
    try:
        return identity_of(path) is None
    except OSError:
        return False


def open_database(path: Path) -> tuple[sqlite3.Connection, StorageTrouble | None]:
    """Open the writing connection. Create the file or migrate it; set a damaged one aside and begin an empty one.

    Return it with a trouble that states what was wrong and what was done; None if nothing was wrong.

    Raises:
        InputError: the database was written by a newer version, or by another program.
        DeviceError: it cannot be used at present; the code says why.
    """
    notice = None
    with translated_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        size = path.stat().st_size if path.exists() else 0
        gone = size < HEADER_BYTES and path.with_name(path.name + MARK).exists()
        try:
            connection = _open(path)
        except sqlite3.DatabaseError as error:
            trouble = trouble_of(error, path)
            if trouble is None or trouble.code != DAMAGED:
                raise
            notice = set_aside(path, str(error))
            connection = _open(path)
        for known in acknowledged_files(path):
            if not known.exists():  # It was moved away or deleted, so that its marker says nothing any more.
                known.with_name(known.name + ACKNOWLEDGED).unlink(missing_ok=True)
        path.with_name(path.name + MARK).touch()
        if gone and notice is None:
            mark = unused_name(path, "deleted")  # an empty file that later starts find
            mark.touch()
            notice = StorageTrouble(
                DELETED,
                f"{path}: the database of earlier starts is not there any more; the history begins anew.",
                "Restore it from a backup while the station is stopped, if it was not deleted on purpose. "
                f"The warning ends when {mark.name} is deleted.",
                mark,
            )
    return connection, notice


def set_aside(path: Path, why: str) -> StorageTrouble:
    """Rename a damaged database, so that the next one begins empty and the old one can still be recovered."""
    kept = unused_name(path, "damaged")
    for ending in _COMPANIONS:
        with contextlib.suppress(FileNotFoundError):
            path.with_name(path.name + ending).rename(kept.with_name(kept.name + ending))
    return StorageTrouble(
        DAMAGED,
        f"{path}: was damaged ({why}); it was set aside as {kept.name}, and the history begins anew.",
        f"Recover {kept.name} with the command sqlite3 (.recover) or restore a backup; check the disk. "
        "The warning ends when the file is moved away or deleted, or when an administrator acknowledges it.",
        kept,
    )


def unused_name(path: Path, what: str) -> Path:
    """Return an unused path beside the database for a file to set aside; `what` is damaged, replaced or deleted."""
    # The time is only a part of a name here; a second set of files within the same second gets a number.
    stem = f"{path.name}.{what}-{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}"
    return next(p for n in range(1000) if not (p := path.with_name(stem if n == 0 else f"{stem}-{n}")).exists())


def earlier_notices(path: Path) -> tuple[StorageTrouble, ...]:
    """Return a notice for every file that an earlier start set aside and that is still there."""
    found = []
    for what, code in (("damaged", DAMAGED), ("deleted", DELETED), ("replaced", REPLACED)):
        for kept in sorted(path.parent.glob(f"{path.name}.{what}-*[0-9Z]")):
            message = f"{kept}: at an earlier time the database was {what}; the present history may lack runs."
            action = "Recover them or restore a backup if they are needed; then move the file away, or acknowledge it."
            found.append(StorageTrouble(code, message, action, kept))
    return tuple(found)


def acknowledged_files(path: Path) -> frozenset[Path]:
    """Return the files beside a database that were set aside and acknowledged."""
    markers = path.parent.glob(f"{path.name}.*{ACKNOWLEDGED}")
    return frozenset(marker.with_name(marker.name.removesuffix(ACKNOWLEDGED)) for marker in markers)


def mark_acknowledged(kept: Path) -> None:
    """Record durably that a person knows of a file that was set aside; DeviceError if the disk refuses it."""
    with translated_errors(kept):
        kept.with_name(kept.name + ACKNOWLEDGED).touch()
        sync_directory(kept.parent)


def connect(path: Path, cache_kib: int | None = None) -> sqlite3.Connection:
    """Open a connection whose transactions are begun and ended by the caller.

    It holds at most `cache_kib` KiB of pages in memory; with None as many as SQLite does, which reads nothing here.
    """
    # isolation_level=None leaves BEGIN and COMMIT to the caller; readers are passed between threads, one at a time.
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=10)
    connection.row_factory = sqlite3.Row
    connection.execute("PRAGMA foreign_keys = ON")
    if cache_kib is not None:
        connection.execute(f"PRAGMA cache_size = -{cache_kib}")
    return connection


def check_at_start(connection: sqlite3.Connection, path: Path) -> None:
    """Check a small database completely; a large one would take too long. DatabaseError: it is damaged."""
    small = path.stat().st_size <= LARGEST_AT_START
    if small and (fault := connection.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
        raise sqlite3.DatabaseError(fault)


def rescue(connection: sqlite3.Connection, path: Path, beat: Callable[[], None]) -> StorageTrouble:
    """Save everything that `connection`, whose file is no longer at the path, can still read.

    A deleted database is put back; one that was replaced is saved beside the other file. `beat` is called meanwhile,
    because a year of results takes minutes. OSError: the disk does not say which of both it is.
    """
    replaced = identity_of(path) is not None
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f"{path.name}.rescued")
    aside.unlink(missing_ok=True)
    connection.set_progress_handler(beat, BEAT_STEPS)
    connection.execute("VACUUM INTO ?", (str(aside),))
    # The write-ahead log of the old file must not be applied to the file that is opened next.
    for ending in ("-wal", "-shm"):
        path.with_name(path.name + ending).unlink(missing_ok=True)
    if not replaced:
        aside.rename(path)
        return StorageTrouble(
            DELETED,
            f"{path}: was deleted while the station ran; it was written back completely.",
            "Find out who deletes files in the data directory.",
        )
    kept = unused_name(path, "replaced")
    aside.rename(kept)
    return StorageTrouble(
        REPLACED,
        f"{path}: was replaced by another file while the station ran. The station goes on with that one; its own was "
        f"saved as {kept.name}.",
        "Stop the station before a database is restored. "
        f"The warning ends when {kept.name} is moved away or deleted, or when an administrator acknowledges it.",
        kept,
    )


def roll_back(connection: sqlite3.Connection) -> None:
    """End a transaction that has failed, if SQLite has not done so itself."""
    # A second ROLLBACK would fail, which would hide the cause.
    if connection.in_transaction:
        with contextlib.suppress(sqlite3.Error):
            connection.execute("ROLLBACK")


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
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if ("runs" in tables) != (version > 0) or (version == 0 and tables):
        raise InputError(
            f"{path}: is a database of another program (tables {', '.join(sorted(tables)[:5]) or 'none'}).",
            action="Move it away, or give the station another data directory.",
            code="database-foreign",
        )


def stand_in(path: Path, trouble: StorageTrouble, count: int) -> list[sqlite3.Connection] | None:
    """Return connections for reading while `trouble` keeps the database from being opened for writing.

    A sound database of this version is read as it is. If there is none because a full disk takes none, the connections
    are to empty databases in memory. A disk that is read-only and has no database may be one that is not mounted yet:
    None is returned where the start has to wait.
    """
    made: list[sqlite3.Connection] = []
    if trouble.code not in PASSING:
        return None
    try:
        if path.exists() and path.stat().st_size >= HEADER_BYTES:
            made += [_unwritten(path) for _ in range(count)]
            (version,) = made[0].execute("PRAGMA user_version").fetchone()
            if version != VERSION:
                raise sqlite3.DatabaseError(f"version {version} of the tables")
            check_at_start(made[0], path)
            return made
        if trouble.code == FULL and path.parent.is_dir():
            for _ in range(count):
                made.append(_reading(":memory:"))
                migrate(made[-1], path)
            return made
    except (sqlite3.Error, OSError):
        # Whatever else is wrong is found when the database can be opened, and named then.
        for connection in made:
            connection.close()
    return None


def is_empty(connection: sqlite3.Connection) -> bool:
    """Return whether a connection is to an empty database in memory."""
    return not connection.execute("PRAGMA database_list").fetchone()[2]


def _unwritten(path: Path) -> sqlite3.Connection:
    """Open a database without writing anything beside it."""
    log = path.with_name(path.name + "-wal")
    # `immutable` leaves out the write-ahead log, so it is right only where there is none. A log is read with the shared
    # memory that its last user left.
    option = "mode=ro" if log.exists() and log.stat().st_size else "immutable=1"
    return _reading(f"{path.as_uri()}?{option}")


def _reading(address: str) -> sqlite3.Connection:
    connection = sqlite3.connect(address, uri=True, isolation_level=None, check_same_thread=False)
    connection.row_factory = sqlite3.Row
    return connection
