"""The present activity of the station, which a restart resumes: one small document per key."""

from __future__ import annotations

import sqlite3
from concurrent.futures import Future

from vaoi_station.store.database import Database


class StandingDocuments:
    """Documents that describe what the station is doing now, by key."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def get(self, key: str) -> str | None:
        """Return the document of a key; None if there is none."""
        rows = self._database.read("SELECT document FROM standing WHERE key = ?", (key,))
        return str(rows[0]["document"]) if rows else None

    def set(self, key: str, document: str | None) -> Future[None]:
        """Write the document of a key, or delete it with None."""

        def write(connection: sqlite3.Connection) -> None:
            connection.execute("DELETE FROM standing WHERE key = ?", (key,))
            if document is not None:
                connection.execute("INSERT INTO standing VALUES (?, ?)", (key, document))

        return self._database.write(write, patient=True, size=len(document or ""))
