"""Storage of what persons have decided about runs: one document per run, deleted with the run's summary."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Sequence

from vaoi_station.store.database import Database
from vaoi_station.store.schema import ANY_OF, keys_of

IN_MEMORY = 1000
"""Number of decisions, about the newest runs, that are kept in memory: documents of these runs need no disk."""


class RunDecisions:
    """The decisions about the runs of one station. A later decision about a run replaces the earlier one."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._lock = threading.Lock()
        self._newest: dict[str, str] | None = None
        """Decisions about the newest runs, by run id; None until they are read."""
        self._from = ""
        """Id from which all decisions are in memory."""

    def save(self, run: str, document: str) -> bool:
        """Write the decision about a run, and wait until this is done; return False if the run is not stored."""

        def write(connection: sqlite3.Connection) -> bool:
            written = connection.execute(
                """INSERT INTO decisions SELECT id, ? FROM runs WHERE id = ?
                   ON CONFLICT (run) DO UPDATE SET document = excluded.document""",
                (document, run),
            )
            return written.rowcount == 1

        with self._lock:
            saved = self._database.write(write).result()
            newest = self._read()
            if saved and run >= self._from:
                newest[run] = document
                if len(newest) > 2 * IN_MEMORY:
                    self._newest = None  # read again, without the oldest
            return saved

    def documents(self, runs: Sequence[str]) -> dict[str, str]:
        """Return the decisions about some runs, by run id; runs without a decision are left out."""
        with self._lock:
            newest, bound = self._read(), self._from
            found = {run: newest[run] for run in runs if run in newest}
        if older := [run for run in runs if run < bound]:
            rows = self._database.read(f"SELECT run, document FROM decisions WHERE run {ANY_OF}", (keys_of(older),))
            found |= {str(row["run"]): str(row["document"]) for row in rows}
        return found

    def _read(self) -> dict[str, str]:
        if self._newest is None:
            rows = self._database.read(
                "SELECT run, document FROM decisions ORDER BY run DESC LIMIT ?", (IN_MEMORY,)
            )  # fmt: skip
            self._newest = {str(row["run"]): str(row["document"]) for row in rows}
            self._from = min(self._newest) if len(rows) == IN_MEMORY else ""
        return self._newest
