"""Which finished runs are kept whole, which as a summary only, and which are pinned.

A run is *whole* while its details, timeline and result are kept. Of a run that is forgotten in part, the row with its
summary is kept. A run that is forgotten completely has no row. Pinned runs are never forgotten.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Sequence
from concurrent.futures import Future

from vaoi_station.errors import StateError
from vaoi_station.store.database import Database

MOST_PINS = 1000
"""Largest number of pinned runs. Pinned runs are never forgotten, so their number must be bounded."""
_UNUSED = """NOT EXISTS (SELECT 1 FROM runs WHERE board_type_digest = documents.digest)
    AND NOT EXISTS (SELECT 1 FROM runs WHERE calibration_digest = documents.digest)
    AND NOT EXISTS (SELECT 1 FROM calibration_checks WHERE calibration_digest = documents.digest)"""
"""SQL: no run and no calibration check refers to a row of `documents`."""
NEVER_FORGOTTEN = 100
"""Number of the newest runs of each kind that are kept whole in spite of the limits."""


class RunRetention:
    """Deletion and pinning of finished runs. Calls that write return a future of the transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._pins: frozenset[str] | None = None
        self._pinning = threading.Lock()
        """Held while pins are changed or read anew, so that neither overwrites the other."""

    def surplus(self, doubtful: bool, keep: int, before: str, limit: int) -> list[str]:
        """Return the oldest whole runs beyond the newest `keep`, or with ids below `before`; at most `limit` ids.

        `doubtful` selects runs whose verdict is not ok; otherwise those whose verdict is ok.
        """
        return self._database.column(
            """SELECT run FROM whole_runs WHERE doubtful = ?1 AND run NOT IN (SELECT run FROM pins)
               AND run < max(
                   coalesce((SELECT run FROM whole_runs WHERE doubtful = ?1 ORDER BY run DESC LIMIT 1 OFFSET ?2), ''),
                   min(?3, coalesce(
                       (SELECT run FROM whole_runs WHERE doubtful = ?1 ORDER BY run DESC LIMIT 1 OFFSET ?4), ''))
               ) ORDER BY run LIMIT ?5""",
            (int(doubtful), keep - 1, before, NEVER_FORGOTTEN - 1, limit),
        )

    def old_summaries(self, keep: int, before: str, limit: int) -> list[str]:
        """Return the oldest runs beyond the newest `keep`, or with ids below `before`; at most `limit` ids.

        Runs that are whole, unfinished or pinned are left out, and those that a calibration check refers to.
        """
        return self._database.column(
            """SELECT id FROM runs WHERE id < max(?2, coalesce(
                   (SELECT id FROM runs ORDER BY id DESC LIMIT 1 OFFSET ?1), ''))
               AND finish_number IS NOT NULL
               AND NOT EXISTS (SELECT 1 FROM whole_runs WHERE run = runs.id)
               AND NOT EXISTS (SELECT 1 FROM pins WHERE run = runs.id)
               AND NOT EXISTS (SELECT 1 FROM calibration_checks WHERE run = runs.id)
               ORDER BY id LIMIT ?3""",
            (keep - 1, before, limit),
        )

    def forget_details(self, runs: Sequence[str]) -> Future[None]:
        """Delete results, heights, measures of parts, details and timelines of runs; their summaries stay."""

        def write(connection: sqlite3.Connection) -> None:
            for run in runs:
                # A run may have been pinned since it was selected.
                if connection.execute("SELECT 1 FROM pins WHERE run = ?", (run,)).fetchone():
                    continue
                connection.execute("DELETE FROM results WHERE run = ?", (run,))
                connection.execute("DELETE FROM heights WHERE run = ?", (run,))
                connection.execute("DELETE FROM parts WHERE run = ?", (run,))
                connection.execute(
                    """UPDATE runs SET detail = '', head = NULL, timeline = NULL, packed_detail = NULL,
                       packed_timeline = NULL WHERE id = ?""",
                    (run,),
                )
                connection.execute("DELETE FROM whole_runs WHERE run = ?", (run,))

        return self._database.write(write)

    def forget_runs(self, runs: Sequence[str]) -> Future[None]:
        """Delete the runs that `old_summaries` has returned from the database."""

        def write(connection: sqlite3.Connection) -> None:
            if not runs:
                return
            connection.executemany(
                """DELETE FROM runs WHERE id = ?1 AND detail = ''
                   AND NOT EXISTS (SELECT 1 FROM calibration_checks WHERE run = ?1)
                   AND NOT EXISTS (SELECT 1 FROM pins WHERE run = ?1)""",
                ((run,) for run in runs),
            )
            known = connection.execute("SELECT max(last) FROM forgotten").fetchone()[0] or ""
            connection.execute("DELETE FROM forgotten")
            connection.execute("INSERT INTO forgotten VALUES (?)", (max(known, *runs),))

        return self._database.write(write)

    def unused_documents(self, before: str, limit: int) -> list[str]:
        """Return the digests of calibrations and board types to which no run and no check refers; at most `limit`.

        Only those that are known since before a time (UTC): one that was armed lately may be used next.
        """
        return self._database.column(
            f"SELECT digest FROM documents WHERE first_seen < ? AND {_UNUSED} LIMIT ?", (before, limit)
        )

    def forget_documents(self, digests: Sequence[str]) -> Future[None]:
        """Delete calibrations and board types, unless a run or a check refers to them by now."""

        def write(connection: sqlite3.Connection) -> None:
            connection.executemany(f"DELETE FROM documents WHERE digest = ? AND {_UNUSED}", ((d,) for d in digests))

        return self._database.write(write)

    def forget_configurations(self, used_before: str) -> Future[int]:
        """Delete the configurations that were used last before a time (UTC); return their number."""
        return self._database.execute("DELETE FROM configurations WHERE last_used < ?", (used_before,))

    def oldest_run(self) -> str | None:
        """Return the lowest run id in use; None without runs."""
        oldest: str | None = self._database.value("SELECT min(id) FROM runs")
        return oldest

    def forgotten(self, run: str) -> bool:
        """Return whether a run that is not in the database is so old that it may have been deleted from there."""
        last: str | None = self._database.value("SELECT max(last) FROM forgotten")
        return last is not None and run <= last

    def used_bytes(self) -> int:
        """Return the size of the database without its free pages, which later writes use first."""
        query = """SELECT (page_count - freelist_count) * page_size
                   FROM pragma_page_count, pragma_freelist_count, pragma_page_size"""
        return int(self._database.value(query))

    def spare_bytes(self) -> int:
        """Return the size of the free pages of the database, into which results fit without more disk space."""
        query = "SELECT freelist_count * page_size FROM pragma_freelist_count, pragma_page_size"
        return int(self._database.value(query))

    @property
    def disk_free_bytes(self) -> int | None:
        """Free space of the data disk at the last check, bytes; None if it is not known."""
        return self._database.free_bytes

    def whole(self) -> tuple[int, int]:
        """Return the numbers of runs that are kept whole: with verdict ok, and all others."""
        rows = self._database.read("SELECT coalesce(sum(1 - doubtful), 0), coalesce(sum(doubtful), 0) FROM whole_runs")
        return int(rows[0][0]), int(rows[0][1])

    def pin(self, run: str, now: str) -> None:
        """Pin a run, and wait until this is written; no effect if it is pinned. StateError: too many are pinned."""

        def write(connection: sqlite3.Connection) -> None:
            if connection.execute("SELECT 1 FROM pins WHERE run = ?", (run,)).fetchone():
                return
            (pins,) = connection.execute("SELECT count(*) FROM pins").fetchone()
            if pins >= MOST_PINS:
                raise StateError(
                    f"{pins} runs are pinned, which is the limit; run {run} was not pinned.",
                    action="Unpin runs that are no longer needed (DELETE runs/{id}/pin).",
                    code="too-many-pins",
                )
            connection.execute("INSERT INTO pins VALUES (?, ?)", (run, now))

        with self._pinning:
            self._database.write(write).result()
            self._pins = self.pins() | {run}

    def unpin(self, run: str) -> None:
        """Remove the pin of a run, and wait until this is written; no effect if it is not pinned."""
        with self._pinning:
            self._database.execute("DELETE FROM pins WHERE run = ?", (run,)).result()
            self._pins = self.pins() - {run}

    def pinned(self, run: str) -> bool:
        """Return whether a run is pinned."""
        return run in self.pins()

    def pins(self) -> frozenset[str]:
        """Return the ids of all pinned runs, from memory, so that calls succeed even if the disk fails."""
        return self._read_pins() if self._pins is None else self._pins

    def refresh_pins(self) -> None:
        """Read the pins anew: `vaoi import` pins runs in a process of its own."""
        with self._pinning:
            self._read_pins()

    def _read_pins(self) -> frozenset[str]:
        self._pins = frozenset(self._database.column("SELECT run FROM pins"))
        return self._pins
