"""Watch of the database's file: whether it was deleted or replaced while it is open, and the free space."""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Callable
from pathlib import Path

from vaoi_station.store.database_file import identity_of, unused_name
from vaoi_station.store.storage_trouble import DELETED, REPLACED, StorageTrouble

BEAT_STEPS = 10_000
"""Steps of SQLite's virtual machine between two heartbeats of a thread, some hundredths of a second."""


class FileWatch:
    """Compares the file at the database's path with the one that was opened. Used by the writer's thread."""

    def __init__(self, path: Path) -> None:
        """Watch the file that is at the path now."""
        self._path = path
        self.forget()
        self.free_bytes: int | None = None
        self.measure()

    @property
    def changed(self) -> bool:
        """Whether the file was deleted or replaced, so that a connection writes to a file that no longer has a name.

        A directory that cannot be read proves neither: the next write shows whether the file can still be used.
        """
        try:
            return identity_of(self._path) != self._opened
        except OSError:
            return False

    def forget(self) -> None:
        """Take the file that is at the path now as the one to watch, whatever was watched before."""
        self._opened = None
        with contextlib.suppress(OSError):
            self._opened = identity_of(self._path)

    def measure(self) -> None:
        """Measure the space that the station may still use."""
        # The last value is kept after an error: if the mount was lost, the next write shows it.
        with contextlib.suppress(OSError):
            found = os.statvfs(self._path.parent)
            self.free_bytes = found.f_bavail * found.f_frsize

    def rescue(self, connection: sqlite3.Connection, beat: Callable[[], None]) -> StorageTrouble:
        """Save everything that `connection`, whose file is no longer at the path, can still read.

        If the database was deleted, it is put back. If another file is in its place, that file is left there, and the
        old content is saved beside it. `beat` is called meanwhile, because a year of results takes minutes. OSError:
        the disk does not say which of both it is.
        """
        replaced = identity_of(self._path) is not None
        self._path.parent.mkdir(parents=True, exist_ok=True)
        aside = self._path.with_name(f"{self._path.name}.rescued")
        aside.unlink(missing_ok=True)
        connection.set_progress_handler(beat, BEAT_STEPS)
        connection.execute("VACUUM INTO ?", (str(aside),))
        # The write-ahead log of the old file must not be applied to the file that is opened next.
        for ending in ("-wal", "-shm"):
            self._path.with_name(self._path.name + ending).unlink(missing_ok=True)
        if not replaced:
            aside.rename(self._path)
            return StorageTrouble(
                DELETED,
                f"{self._path}: was deleted while the station ran; it was written back completely.",
                "Find out who deletes files in the data directory.",
            )
        kept = unused_name(self._path, "replaced")
        aside.rename(kept)
        return StorageTrouble(
            REPLACED,
            f"{self._path}: was replaced by another file while the station ran. The station goes on with that one; "
            f"its own was saved as {kept.name}.",
            "Stop the station before a database is restored. "
            f"The warning ends when {kept.name} is moved away or deleted, or when an administrator acknowledges it.",
            kept,
        )
