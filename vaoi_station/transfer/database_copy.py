"""Read-only access to the database of a station that may be running."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from vaoi_station.errors import DeviceError, InputError
from vaoi_station.store.schema import VERSION

BUSY_S = 30.0


@contextmanager
def reading(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a database for reading; a running station is not disturbed.

    Raises:
        InputError: there is no database, or one of another version of the tables.
        DeviceError: the file cannot be read.
    """
    if not path.is_file():
        raise InputError(f"{path}: does not exist.", action="Give the station.toml of a station that has been started.")
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=BUSY_S)) as connection:
            connection.row_factory = sqlite3.Row
            (found,) = connection.execute("PRAGMA user_version").fetchone()
            if found != VERSION:
                raise InputError(
                    f"{path}: has version {found} of the tables, but this software has version {VERSION}.",
                    action="Use the software of the station; a newer one migrates the file when it starts.",
                )
            yield connection
    except sqlite3.DatabaseError as error:
        raise DeviceError(
            f"{path}: cannot be read ({error}).", action="Check space, permissions and the state of the disk."
        ) from error


def copy_database(path: Path, target: Path) -> None:
    """Copy a database in one consistent state, also while a station writes to it."""
    with reading(path) as connection:
        # One read transaction: the station's writes go to the write-ahead log meanwhile. The copy has no free pages.
        connection.execute("VACUUM INTO ?", (str(target),))


def check_database(path: Path) -> None:
    """Raise DeviceError if a database is damaged, InputError if it has another version of the tables."""
    with reading(path) as connection:
        fault = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
        if fault != "ok":
            raise DeviceError(f"{path}: is not a sound database ({fault}).", code="database-damaged")
