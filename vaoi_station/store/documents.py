"""Typed access to the database: runs, results, events, and the calibrations and board types that runs have used.

Documents are JSON texts, whose content the store does not use. Results never change. The frames of a run are in shared
memory and are lost when the station ends. Therefore, after a restart, the caller marks finished runs with
`mark_frames_gone`, and ends the runs that `unfinished` returns with a reason.
"""

from __future__ import annotations

import hashlib
import sqlite3
from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Literal

from vaoi_station.errors import NotFoundError
from vaoi_station.store.board_stitching import BoardStitching
from vaoi_station.store.configurations import Configurations
from vaoi_station.store.database import Database
from vaoi_station.store.history.board_figures import BoardFigures
from vaoi_station.store.history.calibration_checks import CalibrationChecks
from vaoi_station.store.history.decisions import RunDecisions
from vaoi_station.store.history.identities import IdentityRow, RunIdentities, write_identity
from vaoi_station.store.history.retention import RunRetention
from vaoi_station.store.history.run_search import RunSearch
from vaoi_station.store.schema import ANY_OF, PACKED, keys_of, packed, unpacked
from vaoi_station.store.standing import StandingDocuments
from vaoi_station.store.storage_trouble import StorageTrouble, translated_errors

Kind = Literal["board-type", "calibration"]
EVENTS_KEPT = 100_000
"""Number of events kept; older events are deleted."""
DOCUMENTS_REMEMBERED = 32
"""Number of the latest board types and calibrations that are also kept in memory, for runs that refer to them."""


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
    identity: IdentityRow | None = None
    """Of a run that is written at its end: its identity before its codes are read; None if its boards have none."""


@dataclass(frozen=True)
class EventRow:
    """An entry of the event log as stored: its number and its JSON text."""

    number: int
    document: str


def digest_of(document: str) -> str:
    """Return the digest that identifies a document by its content: the first 16 hex digits of its SHA-256."""
    return hashlib.sha256(document.encode()).hexdigest()[:16]


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


class Store:
    """The documents of one station. Calls that write return a future that completes with the transaction."""

    def __init__(self, database: Database) -> None:
        self.database = self._database = database
        self._documents: OrderedDict[str, tuple[str, str, str, str]] = OrderedDict()
        """Rows of the latest documents, by digest: if the database has to begin anew, the next run needs them."""
        self.checks = CalibrationChecks(database)
        self.heights = ComponentHeights(database)
        self.decisions, self.search = RunDecisions(database), RunSearch(database)
        self.identities, self.figures = RunIdentities(database), BoardFigures(database)
        self.stitching = BoardStitching(database)
        self.retention = RunRetention(database)
        self.standing = StandingDocuments(database)
        self.configurations = Configurations(database)

    @property
    def trouble(self) -> StorageTrouble | None:
        """The trouble that prevents writing to the database at present; None if writes succeed."""
        return self._database.trouble

    @property
    def notices(self) -> tuple[StorageTrouble, ...]:
        """Troubles since the start by which data were lost or moved."""
        return self._database.notices

    @property
    def history_unread(self) -> bool:
        """Whether the station began without a database because the disk was full; an older one may appear later."""
        return self._database.history_unread

    @property
    def free_bytes(self) -> int | None:
        """Free space for the database at the last check, bytes; None if it is not known."""
        return self._database.free_bytes

    def keep_document(self, kind: Kind, document: str, now: str) -> str:
        """Store a board type or a calibration in the form in which it was used, and return its digest."""
        digest = digest_of(document)
        row = (digest, kind, now, document)
        self._documents[digest] = row
        self._documents.move_to_end(digest)
        while len(self._documents) > DOCUMENTS_REMEMBERED:
            self._documents.popitem(last=False)
        # The write is not awaited, so that the line can be armed while the disk is full: runs that refer to it are
        # written later.
        self._database.write(lambda c: c.execute(_KEEP_DOCUMENT, row), patient=True, durable=False, size=len(document))
        return digest

    def document(self, digest: str) -> str:
        """Return a stored board type or calibration; raise NotFoundError if the digest is unknown."""
        if (known := self._documents.get(digest)) is not None:
            return known[3]
        rows = self._database.read("SELECT document FROM documents WHERE digest = ?", (digest,))
        if not rows:
            raise NotFoundError(f"{self._database.path}: there is no document {digest}.")
        return str(rows[0]["document"])

    def save_run(
        self, row: RunRow, timeline: str | None = None, result: str | None = None, *, patient: bool = True
    ) -> Future[None]:
        """Write a run, with its timeline and result if it has them, in one transaction.

        The future completes when the run is on the disk. With `patient`, it waits for the end of a storage trouble.
        """
        used = [d for d in (row.board_type_digest, row.calibration_digest) if d in self._documents]
        documents = [self._documents[digest] for digest in used]

        def write(connection: sqlite3.Connection) -> None:
            # They are missing if a damaged database was set aside.
            for document in documents:
                if connection.execute("SELECT 1 FROM documents WHERE digest = ?", document[:1]).fetchone() is None:
                    connection.execute(_KEEP_DOCUMENT, document)
            # An update, not INSERT OR REPLACE, which would delete the row that results and checks refer to.
            detail, times = packed(row.detail), (None, None) if timeline is None else packed(timeline)
            connection.execute(
                """INSERT INTO runs VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)
                   ON CONFLICT (id) DO UPDATE SET state = excluded.state, finish_number = excluded.finish_number,
                   summary = excluded.summary, detail = excluded.detail, head = excluded.head,
                   timeline = excluded.timeline, packed_detail = excluded.packed_detail,
                   packed_timeline = excluded.packed_timeline""",
                (
                    row.id, row.state, row.finish_number, row.board_type_digest, row.calibration_digest,
                    row.summary, detail[0], row.head, times[0], detail[1], times[1],
                ),
            )  # fmt: skip
            if result is not None:
                connection.execute("INSERT INTO results VALUES (?, ?, ?)", (row.id, *packed(result)))
            if row.identity is not None:
                write_identity(connection, row.id, row.identity)

        size = len(row.summary) + len(row.detail) + len(row.head or "") + len(timeline or "") + len(result or "")
        # A run that begins need not survive a power failure: before its end there is nothing to announce.
        durable = row.finish_number is not None
        return self._database.write(write, patient=patient, durable=durable, size=size)

    def set_state(self, run: str, state: str) -> Future[None]:
        """Set the state of a finished run whose frames were released or evicted; no effect on an unfinished run."""

        def write(connection: sqlite3.Connection) -> None:
            # If the end of a run was never written, the next start must find it as unfinished.
            connection.execute("UPDATE runs SET state = ? WHERE id = ? AND finish_number IS NOT NULL", (state, run))

        return self._database.write(write, patient=True, durable=False, size=100)

    def run(self, run: str) -> RunRow | None:
        """Return one run; None if it does not exist."""
        rows = self._database.read(f"SELECT {_COLUMNS} FROM runs WHERE id = ?", (run,))
        return _row(rows[0]) if rows else None

    def runs(self, limit: int, before: str | None) -> list[RunRow]:
        """Return at most `limit` runs with ids below `before` (None: all), newest first. Details stay packed."""
        return [
            _packed_row(r, r["detail"])
            for r in self._database.read(
                f"SELECT {_COLUMNS} FROM runs WHERE ? IS NULL OR id < ? ORDER BY id DESC LIMIT ?",
                (before, before, limit),
            )
        ]

    def chosen_runs(self, ids: Sequence[str]) -> list[RunRow]:
        """Return the runs with these ids, newest first; ids that do not exist are left out. Details stay packed."""
        rows = self._database.read(
            f"SELECT {_COLUMNS} FROM runs WHERE id {ANY_OF} ORDER BY id DESC", (keys_of(ids),)
        )  # fmt: skip
        return [_packed_row(r, r["detail"]) for r in rows]

    def unfinished(self) -> list[RunRow]:
        """Return the runs that were never finished, oldest first."""
        return [
            _row(r) for r in self._database.read(f"SELECT {_COLUMNS} FROM runs WHERE finish_number IS NULL ORDER BY id")
        ]

    def mark_frames_gone(self, gone: str) -> Future[None]:
        """Set the state of all finished runs with frames to `gone`, because their memory no longer exists.

        The write waits for the end of a storage trouble.
        """

        def write(connection: sqlite3.Connection) -> None:
            # The condition on the state is that of the index `runs_with_frames`.
            connection.execute(
                """UPDATE runs SET state = ? WHERE state IN ('ready', 'degraded', 'failed')
                   AND finish_number IS NOT NULL""",
                (gone,),
            )

        return self._database.write(write, patient=True)

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
        """Return the run of this station that finished last; None before the first."""
        # Runs that were imported have numbers below 0.
        rows = self._database.read(
            f"SELECT {_COLUMNS} FROM runs WHERE finish_number > 0 ORDER BY finish_number DESC LIMIT 1"
        )
        return _row(rows[0]) if rows else None

    def newest_run(self) -> str | None:
        """Return the highest run id in use; None before the first run."""
        value = self._database.read("SELECT max(id) AS id FROM runs")[0]["id"]
        return None if value is None else str(value)

    def result(self, run: str) -> str | None:
        """Return the result of a run; None if it has none."""
        return self._text("SELECT document, packed FROM results WHERE run = ?", run)

    def timeline(self, run: str) -> str | None:
        """Return the timeline of a run; None if it has none yet."""
        return self._text("SELECT timeline, packed_timeline FROM runs WHERE id = ? AND timeline IS NOT NULL", run)

    def _text(self, query: str, run: str) -> str | None:
        """Return the text that a query selects as a column and its packed column; None if there is no row."""
        with translated_errors(self._database.path):
            rows = self._database.read(query, (run,))
            return unpacked(*rows[0]) if rows else None

    def add_event(self, row: EventRow) -> Future[None]:
        """Append an event, and delete the oldest beyond `EVENTS_KEPT`."""

        def write(connection: sqlite3.Connection) -> None:
            # A database that was restored from a backup may contain events with this number.
            connection.execute("INSERT OR REPLACE INTO events VALUES (?, ?)", (row.number, row.document))
            # Old events are deleted only once per 1000 events, so that the usual write concerns one row.
            if row.number % 1000 == 0:
                connection.execute("DELETE FROM events WHERE number <= ?", (row.number - EVENTS_KEPT,))

        return self._database.write(write, patient=True, durable=False, size=len(row.document))

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


_KEEP_DOCUMENT = "INSERT OR IGNORE INTO documents VALUES (?, ?, ?, ?)"
_COLUMNS = "id, state, finish_number, board_type_digest, calibration_digest, summary, detail, head, packed_detail"


def _row(row: sqlite3.Row) -> RunRow:
    try:
        return _packed_row(row, unpacked(row["detail"], row["packed_detail"]))
    except sqlite3.DatabaseError:
        # Shown as a record that cannot be read: no single row may stop a start.
        return _packed_row(row, PACKED)


def _packed_row(row: sqlite3.Row, detail: str) -> RunRow:
    return RunRow(
        row["id"], row["state"], row["finish_number"], row["board_type_digest"], row["calibration_digest"],
        row["summary"], detail, row["head"],
    )  # fmt: skip
