"""Storage of the identities of runs, and the ids by which runs are found."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass

from vaoi_station.store.database import Database
from vaoi_station.store.schema import ANY_OF, DOUBTFUL, keys_of, packed, unpacked
from vaoi_station.store.storage_trouble import translated_errors


@dataclass(frozen=True)
class IdentityRow:
    """The identity of a run as stored."""

    document: str
    board_ids: Sequence[str] = ()
    """The ids by which the run is found."""
    pending: bool = False
    """Whether the codes are not read yet."""
    degrading: Sequence[str] = ()
    """Codes of the reasons for which it degrades the run; empty if it does not."""


class RunIdentities:
    """Storage of the identities of one station's runs."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def save(self, run: str, row: IdentityRow) -> Future[None]:
        """Write the identity of a finished run in place of an earlier one."""

        def write(connection: sqlite3.Connection) -> None:
            if connection.execute("SELECT 1 FROM runs WHERE id = ? AND finish_number IS NOT NULL", (run,)).fetchone():
                write_identity(connection, run, row)

        return self._database.write(write, patient=True, durable=False, size=len(row.document))

    def documents(self, runs: Sequence[str]) -> dict[str, str]:
        """Return the identities of runs by run; runs without one are left out."""
        with translated_errors(self._database.path):
            rows = self._database.read(
                f"SELECT run, document, packed FROM identities WHERE run {ANY_OF}", (keys_of(runs),)
            )
            return {str(row["run"]): unpacked(row["document"], row["packed"]) for row in rows}

    def pending(self) -> list[str]:
        """Return the runs of which the codes are not read yet."""
        with translated_errors(self._database.path):
            return [str(row["run"]) for row in self._database.read("SELECT run FROM identities WHERE pending")]

    def runs_of(self, board_id: str, limit: int, before: str | None) -> list[str]:
        """Return at most `limit` runs with an id, newest first; only runs with ids below `before` (None: all)."""
        rows = self._database.read(
            "SELECT run FROM board_ids WHERE board_id = ? AND (? IS NULL OR run < ?) ORDER BY run DESC LIMIT ?",
            (board_id, before, before, limit),
        )
        return [str(row["run"]) for row in rows]


def write_identity(connection: sqlite3.Connection, run: str, row: IdentityRow) -> None:
    """Write the identity of a run, and what follows from it, in one transaction of the caller."""
    degrading = json.dumps(list(row.degrading)) if row.degrading else None
    connection.execute(
        "INSERT OR REPLACE INTO identities (run, document, packed, pending, degrading) VALUES (?, ?, ?, ?, ?)",
        (run, *packed(row.document), int(row.pending), degrading),
    )
    # A run that its identity degrades is kept as long as others that are not ok.
    connection.execute(
        f"UPDATE whole_runs SET doubtful = ? OR (SELECT {DOUBTFUL} FROM runs AS new WHERE id = run) WHERE run = ?",
        (int(bool(row.degrading)), run),
    )
    connection.execute("DELETE FROM board_ids WHERE run = ?", (run,))
    connection.executemany("INSERT INTO board_ids VALUES (?, ?)", ((board_id, run) for board_id in row.board_ids))
