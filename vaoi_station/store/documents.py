"""Typed access to the database: runs, results, events, and the calibrations and board types that runs have used.

Documents are JSON texts that the store does not interpret. Results never change. The frames of a run are in shared
memory and are lost when the station ends. After a restart the caller therefore marks finished runs with
`mark_frames_gone` and ends the runs from `unfinished` with a reason.
"""

from __future__ import annotations

import hashlib
import sqlite3
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Literal

from vaoi_station.errors import NotFoundError
from vaoi_station.store.board_stitching import BoardStitching
from vaoi_station.store.calibration_checks import CalibrationChecks
from vaoi_station.store.database import Database
from vaoi_station.store.retention import RunRetention

Kind = Literal["board-type", "calibration"]
EVENTS_KEPT = 100_000
"""Number of events kept; older events are deleted."""


@dataclass(frozen=True)
class RunRow:
    """A run as stored. `finish_number` orders runs by the time of their end; it is None for an unfinished run."""

    id: str
    state: str
    finish_number: int | None
    board_type_digest: str
    calibration_digest: str
    summary: str
    detail: str
    head: str | None = None
    """Head of the run's recording as JSON; None while the board is filmed."""


@dataclass(frozen=True)
class EventRow:
    """An entry of the event log as stored: its number and its JSON text."""

    number: int
    document: str


def digest_of(document: str) -> str:
    """Return the digest that identifies a document by its content: the first 16 hex digits of its SHA-256."""
    return hashlib.sha256(document.encode()).hexdigest()[:16]


class Store:
    """The documents of one station. Calls that write return a future that completes with the transaction."""

    def __init__(self, database: Database) -> None:
        self.database = self._database = database
        self.checks = CalibrationChecks(database)
        self.stitching = BoardStitching(database)
        self.retention = RunRetention(database)

    def keep_document(self, kind: Kind, document: str, now: str) -> str:
        """Store a board type or a calibration as it was used, and return its digest."""
        digest = digest_of(document)
        # Wait until the transaction is complete, because runs refer to the digest by a foreign key.
        self._database.write(
            lambda c: c.execute("INSERT OR IGNORE INTO documents VALUES (?, ?, ?, ?)", (digest, kind, now, document))
        ).result()
        return digest

    def document(self, digest: str) -> str:
        """Return a stored board type or calibration; raise NotFoundError if the digest is unknown."""
        rows = self._database.read("SELECT document FROM documents WHERE digest = ?", (digest,))
        if not rows:
            raise NotFoundError(f"{self._database.path}: there is no document {digest}.")
        return str(rows[0]["document"])

    def save_run(self, row: RunRow, timeline: str | None = None, result: str | None = None) -> Future[None]:
        """Write a run, with its timeline and result if it has them, in one transaction."""

        def write(connection: sqlite3.Connection) -> None:
            # An update, not INSERT OR REPLACE, which would delete the row that results and checks refer to.
            connection.execute(
                """INSERT INTO runs VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)
                   ON CONFLICT (id) DO UPDATE SET state = excluded.state, finish_number = excluded.finish_number,
                   summary = excluded.summary, detail = excluded.detail, head = excluded.head,
                   timeline = excluded.timeline""",
                (
                    row.id, row.state, row.finish_number, row.board_type_digest, row.calibration_digest,
                    row.summary, row.detail, row.head, timeline,
                ),
            )  # fmt: skip
            if result is not None:
                connection.execute("INSERT INTO results VALUES (?, ?)", (row.id, result))

        return self._database.write(write)

    def set_state(self, run: str, state: str) -> Future[None]:
        """Set the state of a finished run whose frames were released or evicted."""

        def write(connection: sqlite3.Connection) -> None:
            connection.execute("UPDATE runs SET state = ? WHERE id = ?", (state, run))

        return self._database.write(write)

    def run(self, run: str) -> RunRow | None:
        """Return one run; None if it does not exist."""
        rows = self._database.read(f"SELECT {_COLUMNS} FROM runs WHERE id = ?", (run,))
        return _row(rows[0]) if rows else None

    def runs(self, limit: int, before: str | None) -> list[RunRow]:
        """Return at most `limit` runs with ids below `before` (None: all), newest first."""
        return [
            _row(r)
            for r in self._database.read(
                f"SELECT {_COLUMNS} FROM runs WHERE ? IS NULL OR id < ? ORDER BY id DESC LIMIT ?",
                (before, before, limit),
            )
        ]

    def unfinished(self) -> list[RunRow]:
        """Return the runs that were never finished, oldest first."""
        return [
            _row(r) for r in self._database.read(f"SELECT {_COLUMNS} FROM runs WHERE finish_number IS NULL ORDER BY id")
        ]

    def mark_frames_gone(self, gone: str) -> Future[None]:
        """Set the state of all finished runs with frames to `gone`, because their memory no longer exists."""

        def write(connection: sqlite3.Connection) -> None:
            # The condition on the state is that of the index `runs_with_frames`.
            connection.execute(
                """UPDATE runs SET state = ? WHERE state IN ('ready', 'degraded', 'failed')
                   AND finish_number IS NOT NULL""",
                (gone,),
            )

        return self._database.write(write)

    def finished_after(self, finish_number: int) -> RunRow | None:
        """Return the run that finished next after `finish_number` (0: the first of all); None if there is none.

        Runs of which only a summary is kept are left out.
        """
        rows = self._database.read(
            f"""SELECT {_COLUMNS} FROM runs WHERE id = (
                SELECT run FROM whole_runs WHERE finish_number > ? ORDER BY finish_number LIMIT 1)""",
            (finish_number,),
        )
        return _row(rows[0]) if rows else None

    def last_finished(self) -> RunRow | None:
        """Return the run that finished last; None before the first."""
        rows = self._database.read(
            f"SELECT {_COLUMNS} FROM runs WHERE finish_number IS NOT NULL ORDER BY finish_number DESC LIMIT 1"
        )
        return _row(rows[0]) if rows else None

    def newest_run(self) -> str | None:
        """Return the highest run id in use; None before the first run."""
        value = self._database.read("SELECT max(id) AS id FROM runs")[0]["id"]
        return None if value is None else str(value)

    def result(self, run: str) -> str | None:
        """Return the result of a run; None if it has none."""
        rows = self._database.read("SELECT document FROM results WHERE run = ?", (run,))
        return str(rows[0]["document"]) if rows else None

    def timeline(self, run: str) -> str | None:
        """Return the timeline of a run; None if it has none yet."""
        rows = self._database.read("SELECT timeline FROM runs WHERE id = ?", (run,))
        return None if not rows or rows[0]["timeline"] is None else str(rows[0]["timeline"])

    def add_event(self, row: EventRow) -> Future[None]:
        """Append an event, and delete the oldest beyond `EVENTS_KEPT`."""

        def write(connection: sqlite3.Connection) -> None:
            connection.execute("INSERT INTO events VALUES (?, ?)", (row.number, row.document))
            # Deleting once per 1000 events keeps the usual write to one row.
            if row.number % 1000 == 0:
                connection.execute("DELETE FROM events WHERE number <= ?", (row.number - EVENTS_KEPT,))

        return self._database.write(write)

    def events(self, after: int, limit: int) -> list[EventRow]:
        """Return at most `limit` events numbered above `after`, oldest first."""
        rows = self._database.read("SELECT * FROM events WHERE number > ? ORDER BY number LIMIT ?", (after, limit))
        return [EventRow(int(r["number"]), str(r["document"])) for r in rows]

    def last_event(self) -> int:
        """Return the number of the newest event; 0 before the first."""
        return int(self._database.read("SELECT coalesce(max(number), 0) AS number FROM events")[0]["number"])

    def close(self) -> None:
        """Finish all writes and close the file."""
        self._database.close()


_COLUMNS = "id, state, finish_number, board_type_digest, calibration_digest, summary, detail, head"


def _row(row: sqlite3.Row) -> RunRow:
    return RunRow(*row)
