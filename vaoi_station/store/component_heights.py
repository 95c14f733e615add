"""Heights of components: one document per run that has them. They are deleted with the result of the run."""

from __future__ import annotations

import sqlite3
from concurrent.futures import Future

from vaoi_station.store.database import Database
from vaoi_station.store.schema import packed, unpacked
from vaoi_station.store.storage_trouble import translated_errors


class ComponentHeights:
    """Storage of the measured heights of one station's runs."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def save(self, run: str, document: str) -> Future[None]:
        """Write the heights of a finished run. Later calls for the same run have no effect, as the heights are kept.

        Nothing is written of a run whose result was deleted meanwhile.
        """
        text, content = packed(document)

        def write(connection: sqlite3.Connection) -> None:
            connection.execute(
                """INSERT OR IGNORE INTO heights SELECT id, ?, ? FROM runs
                   WHERE id = ? AND finish_number IS NOT NULL AND detail <> ''""",
                (text, content, run),
            )

        return self._database.write(write, patient=True, durable=False, size=len(document))

    def document(self, run: str) -> str | None:
        """Return the heights of a run; None if it has none."""
        with translated_errors(self._database.path):
            rows = self._database.read("SELECT document, packed FROM heights WHERE run = ?", (run,))
            return unpacked(*rows[0]) if rows else None
