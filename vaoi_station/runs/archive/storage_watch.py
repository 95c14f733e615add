"""Watch of the storage: its troubles become warnings of the station and events."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

from vaoi_station.errors import DeviceError
from vaoi_station.model import Reason
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.states.schemas import SetAsideFile
from vaoi_station.store import StorageTrouble, Store

LOW_BYTES = 500_000_000
"""Space on the data disk below which the station warns."""


class StorageFigures(NamedTuple):
    """Sizes of the storage at one moment, of the database without its free pages; None: not known."""

    free_bytes: int | None
    database_bytes: int | None
    unstored: int
    """Number of finished runs that are in memory only."""
    trouble: str
    """Code of the trouble because of which results are not written; empty if they are."""


class StorageWatch:
    """The state of the storage, as warnings and events. `tick` is called by the coordinator's thread."""

    def __init__(self, store: Store, events: EventLog, count_unstored: Callable[[], int]) -> None:
        """Begin to watch; `count_unstored` returns the number of finished runs that are in memory only."""
        self._store, self._events, self._count_unstored = store, events, count_unstored
        self._trouble: StorageTrouble | None = None
        self._published: set[StorageTrouble] = set()
        self._low = False

    @property
    def in_trouble(self) -> bool:
        """Whether the storage accepts no writes at present."""
        return self._trouble is not None

    def tick(self) -> None:
        """Publish what has changed since the last tick."""
        before, now = self._trouble, self._store.database.trouble
        self._trouble = now
        if now is not None and (before is None or before.code != now.code):
            self._events.add("trouble", now.message, code=now.code, action=now.action)
        elif now is None and before is not None:
            self._events.add("storage", "The database is written again.", code="storage-back")
        # Notices come and go: one ends when the file that it names was cleared away.
        notices = self._store.database.notices
        for notice in notices:
            if notice not in self._published:
                self._events.add("trouble", notice.message, code=notice.code, action=notice.action)
        self._published = set(notices)
        low = self._low_space()
        if low is not None and not self._low:
            self._events.add("trouble", low.message, code=low.code, action=low.action)
        self._low = low is not None

    def present(self) -> Reason | None:
        """Return the trouble because of which results are not written at present; None if they are."""
        if (trouble := self._trouble) is None:
            return None
        count = self._count_unstored()
        waiting = f" {count} finished runs wait in memory." if count else ""
        return Reason(code=trouble.code, message=trouble.message + waiting, action=trouble.action)

    def figures(self) -> StorageFigures:
        """Return the sizes of the storage. Callable from any thread."""
        used = None
        with suppress(DeviceError):  # the database cannot be read at present
            used = self._store.retention.used_bytes()
        trouble = self._trouble
        return StorageFigures(
            self._store.database.free_bytes, used, self._count_unstored(), "" if trouble is None else trouble.code
        )

    def warnings(self) -> tuple[Reason, ...]:
        """Return a warning for each present trouble, for each event that lost or moved data, and for low disk space."""
        database, present = self._store.database, self.present() or self._low_space()
        lost = [n for n in database.notices if n.kept not in database.acknowledged]
        found = [] if present is None else [present]
        return (*found, *(Reason(code=n.code, message=n.message, action=n.action) for n in lost))

    def set_aside(self) -> tuple[SetAsideFile, ...]:
        """Return the files of databases that were set aside and are still there."""
        known = self._store.database.acknowledged
        kept = ((n.kept, n.code) for n in self._store.database.notices)
        return tuple(SetAsideFile(file=k.name, code=code, acknowledged=k in known) for k, code in kept if k is not None)

    def acknowledge(self, file: str) -> None:
        """End the warning about a file that was set aside, also for later starts; NotFoundError: there is none.

        Callable from any thread.
        """
        self._store.database.acknowledge(file)
        self._events.add("storage", f"The warning about {file} was acknowledged.", code="acknowledged")

    def _low_space(self) -> Reason | None:
        free = self._store.database.free_bytes
        if free is None or free >= LOW_BYTES:
            return None
        return Reason(
            code="storage-low",
            message=f"The data disk has {free / 1e6:.0f} MB left; below {LOW_BYTES / 1e6:.0f} MB the station warns.",
            action="Free space in the data directory, or give it a larger disk.",
        )
