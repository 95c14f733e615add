"""Troubles of the storage: the cause of an error of SQLite or of a file, and whether it can pass by itself."""

from __future__ import annotations

import errno
import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from vaoi_station.errors import DeviceError, InternalError, VaoiError

FULL, READ_ONLY, UNAVAILABLE = "storage-full", "storage-read-only", "storage-unavailable"
DAMAGED, DELETED, REPLACED = "database-damaged", "database-deleted", "database-replaced"
NEWER, FOREIGN = "database-newer", "database-foreign"
PASSING = frozenset({FULL, READ_ONLY, UNAVAILABLE})
"""Codes of causes that pass, or that can be removed while the station runs. A write that failed is tried again."""
CODES = PASSING | {DAMAGED, DELETED, REPLACED, NEWER, FOREIGN}
"""All codes of storage troubles."""

_ACTIONS = {
    FULL: "Free space in the data directory; what waits in memory is written then.",
    READ_ONLY: "Make the data directory writable for the station; what waits in memory is written then.",
    UNAVAILABLE: "Check disk, mount and permissions of the data directory; what waits in memory is written then.",
    DAMAGED: "Restore it from a backup, or move it away; the station then begins with an empty one.",
}
_OF_SQLITE = {
    sqlite3.SQLITE_FULL: FULL,
    sqlite3.SQLITE_READONLY: READ_ONLY,
    sqlite3.SQLITE_PERM: READ_ONLY,
    sqlite3.SQLITE_IOERR: UNAVAILABLE,
    sqlite3.SQLITE_CANTOPEN: UNAVAILABLE,
    sqlite3.SQLITE_BUSY: UNAVAILABLE,
    sqlite3.SQLITE_LOCKED: UNAVAILABLE,
    sqlite3.SQLITE_PROTOCOL: UNAVAILABLE,
    sqlite3.SQLITE_NOMEM: UNAVAILABLE,
    sqlite3.SQLITE_CORRUPT: DAMAGED,
    sqlite3.SQLITE_NOTADB: DAMAGED,
}
_OF_SYSTEM = {
    errno.ENOSPC: FULL,
    errno.EDQUOT: FULL,
    errno.EROFS: READ_ONLY,
    errno.EACCES: READ_ONLY,
    errno.EPERM: READ_ONLY,
}


@dataclass(frozen=True)
class StorageTrouble:
    """A fault of the storage, or an action that was taken because of it: code, message and advice."""

    code: str
    message: str
    action: str = ""
    kept: Path | None = None
    """File with the data that were set aside. While it exists, the warning about it stays, also after a restart."""

    def error(self) -> DeviceError:
        """Return the trouble as an error for a caller."""
        return DeviceError(self.message, action=self.action, code=self.code)


def trouble_of(error: BaseException, path: Path) -> StorageTrouble | None:
    """Return the trouble of the storage behind an error; None if the error has another cause."""
    if isinstance(error, OSError):
        code = _refined(_OF_SYSTEM.get(error.errno or 0, UNAVAILABLE), path)
        return StorageTrouble(code, f"{path}: cannot be used ({error.strerror or error}).", _ACTIONS[code])
    # Opening the file again already reports its errors in the station's words.
    if isinstance(error, VaoiError) and error.code in CODES:
        return StorageTrouble(error.code, error.message, error.action)
    if not isinstance(error, sqlite3.DatabaseError):
        return None
    # The low byte is the primary code (SQLite documentation, "Result and Error Codes"). Errors that the Python module
    # itself raises have no code.
    found = _OF_SQLITE.get(getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF)
    # `quick_check` reports damage as a row; it is raised here as a plain DatabaseError.
    if found is None and type(error) is sqlite3.DatabaseError:
        found = DAMAGED
    if found is None:
        return None
    found = _refined(found, path)
    what = "is not a sound database" if found == DAMAGED else "cannot be used"
    return StorageTrouble(found, f"{path}: {what} ({error}).", _ACTIONS[found])


def _refined(code: str, path: Path) -> str:
    """Return the code of the cause that prevents the use of a file, also where the error itself does not show it."""
    if code != UNAVAILABLE:
        return code
    # SQLite reports "disk I/O error" where a full disk has no page for its shared memory, and "unable to open database
    # file" where it may not be made.
    try:
        disk = os.statvfs(path.parent)
    except OSError:
        return code
    if disk.f_flag & os.ST_RDONLY:
        return READ_ONLY
    return FULL if disk.f_blocks and not disk.f_bavail else code


def translated(error: Exception, path: Path) -> VaoiError:
    """Return an error of SQLite or of a file as an error of the station, with the path and an action."""
    if (trouble := trouble_of(error, path)) is not None:
        return trouble.error()
    if isinstance(error, sqlite3.IntegrityError):
        return InternalError(f"{path}: refused a write ({error}).")
    return DeviceError(f"{path}: cannot be used ({error}).", action="Report it to the maintainer.")


@contextmanager
def translated_errors(path: Path) -> Iterator[None]:
    """Convert errors of SQLite and of files to errors of the station."""
    try:
        yield
    except (sqlite3.Error, OSError) as error:
        raise translated(error, path) from error
