"""A storage that waits before every access, so that an addition to an archive takes only the time that it may."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from vaoi_station.plant.storage import Entry, Storage


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
