"""Storage of the identities of runs, and the ids by which runs are found."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from concurrent.futures import Future

from vaoi_station.store.database import Database
from vaoi_station.store.schema import packed, unpacked
from vaoi_station.store.storage_trouble import translated_errors


class RunIdentities:
    """Storage of the identities of one station's runs."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def save(self, run: str, document: str, board_ids: Sequence[str]) -> Future[None]:
        """Write the identity of a finished run, and the ids by which the run is found, in place of earlier ones."""
        text, content = packed(document)

        def write(connection: sqlite3.Connection) -> None:
            if connection.execute("SELECT 1 FROM runs WHERE id = ? AND finish_number IS NOT NULL", (run,)).fetchone():
                write_identity(connection, run, (text, content), board_ids)

        return self._database.write(write, patient=True, durable=False, size=len(document))

    def documents(self, runs: Sequence[str]) -> dict[str, str]:
        """Return the identities of runs by run; runs without one are left out."""
        marks = ", ".join("?" * len(runs))
        with translated_errors(self._database.path):
            rows = self._database.read(
                f"SELECT run, document, packed FROM identities WHERE run IN ({marks})", tuple(runs)
            )
            return {str(row["run"]): unpacked(row["document"], row["packed"]) for row in rows}

    def runs_of(self, board_id: str, limit: int, before: str | None) -> list[str]:
        """Return at most `limit` runs with an id, newest first; only runs with ids below `before` (None: all)."""
        rows = self._database.read(
            "SELECT run FROM board_ids WHERE board_id = ? AND (? IS NULL OR run < ?) ORDER BY run DESC LIMIT ?",
            (board_id, before, before, limit),
        )
        return [str(row["run"]) for row in rows]


def write_identity(
    connection: sqlite3.Connection, run: str, document: tuple[str, bytes | None], board_ids: Sequence[str]
) -> None:
    """Write the identity of a run, packed, and its ids in one transaction of the caller."""
    connection.execute("INSERT OR REPLACE INTO identities VALUES (?, ?, ?)", (run, *document))
    connection.execute("DELETE FROM board_ids WHERE run = ?", (run,))
    connection.executemany("INSERT INTO board_ids VALUES (?, ?)", ((board_id, run) for board_id in board_ids))
