"""The configurations with which runs were made, by digest."""

from __future__ import annotations

import hashlib
from contextlib import suppress

from vaoi_station.errors import DeviceError, NotFoundError
from vaoi_station.store.database import Database

_DAY = len("2026-01-31")


class Configurations:
    """Configurations of the station, each stored once. Usable from any thread."""

    def __init__(self, database: Database) -> None:
        self._database, self._document = database, ""
        self.present = ""
        """Digest of the configuration in force; empty before `begin`."""

    def begin(self, document: str, now: str) -> str:
        """Store the configuration with which the station starts, and return its digest."""
        digest = hashlib.sha256(document.encode()).hexdigest()[:16]
        self.present, self._document = digest, document
        self.store_again(now)
        return digest

    def store_again(self, now: str) -> None:
        """Store the configuration in force, and once a day that it was used.

        The database may have been replaced by an empty one since the last call.
        """
        rows = self._database.read("SELECT last_used FROM configurations WHERE digest = ?", (self.present,))
        if rows and str(rows[0]["last_used"])[:_DAY] == now[:_DAY]:
            return
        row = (self.present, now, self._document, now)
        # A disk that takes nothing does not keep the station from starting; the next call stores it.
        with suppress(DeviceError):
            self._database.write(
                lambda c: c.execute(
                    """INSERT INTO configurations VALUES (?, ?, ?, ?)
                       ON CONFLICT (digest) DO UPDATE SET last_used = excluded.last_used""",
                    row,
                )
            ).result()

    def document(self, digest: str) -> str:
        """Return a stored configuration as JSON text; raise NotFoundError if the digest is unknown."""
        rows = self._database.read("SELECT document FROM configurations WHERE digest = ?", (digest,))
        if not rows:
            raise NotFoundError(f"{self._database.path}: there is no configuration {digest!r}.")
        return str(rows[0]["document"])
