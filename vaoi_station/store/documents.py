"""What is kept, in the words of the house: runs, results, calibrations and board types seen, events.

Documents are JSON texts; what they mean is the callers' affair. Results never change. A run's frames
live in shared memory and die with the station, so opening the store marks every run of an earlier
life: finished ones are "gone", unfinished ones the caller gets back, to end them with a reason.
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

Kind = Literal["board-type", "calibration"]
EVENTS_KEPT = 100_000


@dataclass(frozen=True)
class RunRow:
    """A run as it is kept; `finish_number` orders runs by their end, None: not finished."""

    id: str
    state: str
    finish_number: int | None
    board_type_digest: str
    calibration_digest: str
    summary: str
    detail: str
    head: str | None = None
    """What was filmed (a recording's head); None while it is filmed."""


@dataclass(frozen=True)
class EventRow:
    """An event as it is kept."""

    number: int
    document: str


def digest_of(document: str) -> str:
    """Name of a document by its content: the first 16 hex digits of its SHA-256."""
    return hashlib.sha256(document.encode()).hexdigest()[:16]


class Store:
    """The documents of one station; methods that write return a future that is done when it is on disk."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self.checks = CalibrationChecks(database)
        self.stitching = BoardStitching(database)

    def keep_document(self, kind: Kind, document: str, now: str) -> str:
        """Remember a board type or a calibration as it was used; its digest names it from then on."""
        digest = digest_of(document)
        self._database.write(
            lambda c: c.execute("INSERT OR IGNORE INTO documents VALUES (?, ?, ?, ?)", (digest, kind, now, document))
        ).result()
        return digest

    def document(self, digest: str) -> str:
        """A board type or calibration that was used once."""
        rows = self._database.read("SELECT document FROM documents WHERE digest = ?", (digest,))
        if not rows:
            raise NotFoundError(f"{self._database.path}: there is no document {digest}.")
        return str(rows[0]["document"])

    def save_run(self, row: RunRow, timeline: str | None = None, result: str | None = None) -> Future[None]:
        """Write a run, with its timeline and its result once it has them, all in one transaction."""

        def write(connection: sqlite3.Connection) -> None:
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
        """Note that a finished run's frames were released or are gone."""

        def write(connection: sqlite3.Connection) -> None:
            connection.execute("UPDATE runs SET state = ? WHERE id = ?", (state, run))

        return self._database.write(write)

    def run(self, run: str) -> RunRow | None:
        """One run."""
        rows = self._database.read(f"SELECT {_COLUMNS} FROM runs WHERE id = ?", (run,))
        return _row(rows[0]) if rows else None

    def runs(self, limit: int, before: str | None) -> list[RunRow]:
        """Runs with ids below `before` (None: all), newest first."""
        return [
            _row(r)
            for r in self._database.read(
                f"SELECT {_COLUMNS} FROM runs WHERE ? IS NULL OR id < ? ORDER BY id DESC LIMIT ?",
                (before, before, limit),
            )
        ]

    def unfinished(self) -> list[RunRow]:
        """Runs an earlier life of the station did not bring to an end, oldest first."""
        return [
            _row(r) for r in self._database.read(f"SELECT {_COLUMNS} FROM runs WHERE finish_number IS NULL ORDER BY id")
        ]

    def mark_frames_gone(self, gone: str) -> Future[None]:
        """All finished runs of earlier lives: their memory no longer exists."""

        def write(connection: sqlite3.Connection) -> None:
            connection.execute("UPDATE runs SET state = ? WHERE finish_number IS NOT NULL AND state <> ?", (gone, gone))

        return self._database.write(write)

    def finished_after(self, finish_number: int) -> RunRow | None:
        """The run that finished next after one of that number (0: the first of all)."""
        rows = self._database.read(
            f"SELECT {_COLUMNS} FROM runs WHERE finish_number > ? ORDER BY finish_number LIMIT 1",
            (finish_number,),
        )
        return _row(rows[0]) if rows else None

    def last_finished(self) -> RunRow | None:
        """The run that finished last."""
        rows = self._database.read(
            f"SELECT {_COLUMNS} FROM runs WHERE finish_number IS NOT NULL ORDER BY finish_number DESC LIMIT 1"
        )
        return _row(rows[0]) if rows else None

    def newest_run(self) -> str | None:
        """The highest id ever given to a run that was filmed."""
        value = self._database.read("SELECT max(id) AS id FROM runs")[0]["id"]
        return None if value is None else str(value)

    def result(self, run: str) -> str | None:
        """The result of a run; None if it has none."""
        rows = self._database.read("SELECT document FROM results WHERE run = ?", (run,))
        return str(rows[0]["document"]) if rows else None

    def timeline(self, run: str) -> str | None:
        """The timeline of a finished run."""
        rows = self._database.read("SELECT timeline FROM runs WHERE id = ?", (run,))
        return None if not rows or rows[0]["timeline"] is None else str(rows[0]["timeline"])

    def add_event(self, row: EventRow) -> Future[None]:
        """Append an event; of very many the oldest go."""

        def write(connection: sqlite3.Connection) -> None:
            connection.execute("INSERT INTO events VALUES (?, ?)", (row.number, row.document))
            if row.number % 1000 == 0:
                connection.execute("DELETE FROM events WHERE number <= ?", (row.number - EVENTS_KEPT,))

        return self._database.write(write)

    def events(self, after: int, limit: int) -> list[EventRow]:
        """Events numbered above `after`, oldest first."""
        rows = self._database.read("SELECT * FROM events WHERE number > ? ORDER BY number LIMIT ?", (after, limit))
        return [EventRow(int(r["number"]), str(r["document"])) for r in rows]

    def last_event(self) -> int:
        """Number of the newest event; 0 before the first."""
        return int(self._database.read("SELECT coalesce(max(number), 0) AS number FROM events")[0]["number"])

    def close(self) -> None:
        """Finish all writes and close the file."""
        self._database.close()


_COLUMNS = "id, state, finish_number, board_type_digest, calibration_digest, summary, detail, head"


def _row(row: sqlite3.Row) -> RunRow:
    return RunRow(*row)
