"""Typed access to the database: runs, results, events, and the calibrations and board types that runs have used.

Documents are JSON texts, whose content the store does not use. A result never changes once it is complete. The frames
of a run are in shared memory and are lost when the station ends. Therefore, after a restart, the caller marks finished
runs with `mark_frames_gone`, and ends the runs that `unfinished` returns with a reason.
"""

from __future__ import annotations

import hashlib
import sqlite3
from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

from vaoi_station.errors import DeviceError, NotFoundError
from vaoi_station.store.database import Database
from vaoi_station.store.figures import BoardFigures
from vaoi_station.store.retention import RunRetention
from vaoi_station.store.run_search import RunSearch
from vaoi_station.store.schema import ANY_OF, DOUBTFUL, QUICK, keys_of, packed, unpacked

Kind = Literal["board-type", "calibration"]
EVENTS_KEPT = 100_000
"""Number of events kept; older events are deleted."""
FIRST_KEPT, LATEST_KEPT = 100, 2000
"""Numbers of checks kept per calibration: the first ones after the calibration came into force, and the latest ones."""
_FIRST_OR_LATEST = """(
    run IN (SELECT run FROM calibration_checks WHERE calibration_digest = ?1 ORDER BY run LIMIT ?2)
    OR run IN (SELECT run FROM calibration_checks WHERE calibration_digest = ?1 ORDER BY run DESC LIMIT ?3))"""
"""SQL: a check is among the first ?2 or the latest ?3 of its calibration; run ids sort by time."""
_BASELINES = "lamp-baselines"
_DAY = len("2026-01-31")
DOCUMENTS_REMEMBERED = 32
"""Number of the latest board types and calibrations that are also kept in memory, for runs that refer to them."""


@dataclass(frozen=True)
class IdentityRow:
    """The identity of a run as stored, the ids by which the run is found, and whether its codes are not read yet."""

    document: str
    board_ids: Sequence[str] = ()
    pending: bool = False


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


def digest_of(document: str) -> str:
    """Return the digest that identifies a document by its content: the first 16 hex digits of its SHA-256."""
    return hashlib.sha256(document.encode()).hexdigest()[:16]


class KeyedTexts:
    """A small table with one text per key, not packed. With `patient`, writes wait for the end of a storage trouble."""

    def __init__(
        self, database: Database, table: str, *, key: str, column: str = "document", patient: bool = False
    ) -> None:
        self._database, self._patient = database, patient
        self._table, self._key, self._column = table, key, column

    def get(self, key: str) -> str | None:
        """Return the text of a key; None if there is none."""
        found = self._database.value(f"SELECT {self._column} FROM {self._table} WHERE {self._key} = ?", (key,))
        return None if found is None else str(found)

    def all(self) -> list[str]:
        """Return the texts of all keys."""
        return self._database.column(f"SELECT {self._column} FROM {self._table}")

    def set(self, key: str, text: str | None) -> Future[int]:
        """Write the text of a key, in place of an earlier one, or delete it with None."""
        if text is None:
            statement, values = f"DELETE FROM {self._table} WHERE {self._key} = ?", (key,)
            return self._database.execute(statement, values, patient=self._patient)
        statement = f"INSERT OR REPLACE INTO {self._table} VALUES (?, ?)"
        return self._database.execute(statement, (key, text), patient=self._patient, size=len(text))


class CalibrationChecks:
    """Calibration checks: one small document per run, grouped by the calibration the run was stitched with."""

    def __init__(self, database: Database, standing: KeyedTexts) -> None:
        self._database, self._standing = database, standing

    def save(self, run: str, calibration_digest: str, document: str) -> Future[None]:
        """Save the check of a run. Delete checks of its calibration that are neither among the first nor the latest."""

        def write(connection: sqlite3.Connection) -> None:
            row = (run, calibration_digest, document)
            connection.execute("INSERT OR REPLACE INTO calibration_checks VALUES (?, ?, ?)", row)
            connection.execute(
                f"DELETE FROM calibration_checks WHERE calibration_digest = ?1 AND NOT {_FIRST_OR_LATEST}",
                (calibration_digest, FIRST_KEPT, LATEST_KEPT),
            )

        return self._database.write(write, patient=True, durable=False, size=len(document))

    def documents(self, calibration_digest: str, first: int, latest: int) -> list[str]:
        """Return the `first` oldest and `latest` newest checks of a calibration, oldest first, without duplicates."""
        return self._database.column(
            f"""SELECT document FROM calibration_checks WHERE calibration_digest = ?1 AND {_FIRST_OR_LATEST}
                ORDER BY run""",
            (calibration_digest, first, latest),
        )

    def count(self, calibration_digest: str) -> int:
        """Return the number of checks kept for a calibration."""
        query = "SELECT count(*) FROM calibration_checks WHERE calibration_digest = ?"
        return int(self._database.value(query, (calibration_digest,)))

    def baselines(self) -> str | None:
        """Return the document of all board types' brightness that was saved last; None if there is none."""
        return self._standing.get(_BASELINES)

    def save_baselines(self, document: str) -> Future[int]:
        """Save the brightness of all board types in one document, whether or not the checks that it is of are kept."""
        return self._standing.set(_BASELINES, document)


class RunIdentities:
    """The identities of runs, and the ids by which runs are found."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def save(self, run: str, row: IdentityRow, summary: str, state: str) -> Future[None]:
        """Write the identity of a finished run, and the summary and state that follow from it.

        A state that says that the frames are gone stays.
        """

        def write(connection: sqlite3.Connection) -> None:
            changed = connection.execute(
                """UPDATE runs SET summary = ?, state = CASE WHEN state IN ('ready', 'degraded') THEN ? ELSE state END
                   WHERE id = ? AND finish_number IS NOT NULL""",
                (summary, state, run),
            )
            if changed.rowcount:
                write_identity(connection, run, row)
                # A run that its identity degrades is kept as long as others that are not ok.
                connection.execute(
                    f"""UPDATE whole_runs SET doubtful = (SELECT {DOUBTFUL} FROM runs AS new WHERE id = ?1)
                        WHERE run = ?1""",
                    (run,),
                )

        return self._database.write(write, patient=True, durable=False, size=len(row.document) + len(summary))

    def document(self, run: str) -> str | None:
        """Return the identity of a run; None if it has none."""
        return self._database.text("SELECT document, packed FROM identities WHERE run = ?", (run,))

    def pending(self) -> list[str]:
        """Return the runs of which the codes are not read yet."""
        return self._database.column("SELECT run FROM identities WHERE pending")

    def runs_of(self, board_id: str, limit: int, before: str | None) -> list[str]:
        """Return at most `limit` runs with an id, newest first; only runs with ids below `before` (None: all)."""
        return self._database.column(
            "SELECT run FROM board_ids WHERE board_id = ? AND (? IS NULL OR run < ?) ORDER BY run DESC LIMIT ?",
            (board_id, before, before, limit),
        )


def write_identity(connection: sqlite3.Connection, run: str, row: IdentityRow) -> None:
    """Write the identity of a run, in a transaction of the caller."""
    connection.execute(
        "INSERT OR REPLACE INTO identities (run, document, packed, pending) VALUES (?, ?, ?, ?)",
        (run, *packed(row.document), int(row.pending)),
    )
    connection.execute("DELETE FROM board_ids WHERE run = ?", (run,))
    connection.executemany("INSERT INTO board_ids VALUES (?, ?)", ((board_id, run) for board_id in row.board_ids))


class Configurations:
    """The configurations with which runs were made, by digest, each stored once. Usable from any thread."""

    def __init__(self, database: Database) -> None:
        self._database, self._document = database, ""
        self.present = ""
        """Digest of the configuration in force; empty before `begin`."""

    def begin(self, document: str, now: str) -> str:
        """Store the configuration with which the station starts, and return its digest."""
        self.present, self._document = digest_of(document), document
        self.store_again(now)
        return self.present

    def store_again(self, now: str) -> None:
        """Store the configuration in force, and once a day that it was used.

        The database may have been replaced by an empty one since the last call.
        """
        used = self._database.value("SELECT last_used FROM configurations WHERE digest = ?", (self.present,))
        if used is not None and used[:_DAY] == now[:_DAY]:
            return
        # A disk that takes nothing does not keep the station from starting; the next call stores it.
        with suppress(DeviceError):
            self._database.execute(
                """INSERT INTO configurations VALUES (?, ?, ?, ?)
                   ON CONFLICT (digest) DO UPDATE SET last_used = excluded.last_used""",
                (self.present, now, self._document, now),
            ).result()

    def document(self, digest: str) -> str:
        """Return a stored configuration as JSON text; raise NotFoundError if the digest is unknown."""
        found = self._database.value("SELECT document FROM configurations WHERE digest = ?", (digest,))
        if found is None:
            raise NotFoundError(f"{self._database.path}: there is no configuration {digest!r}.")
        return str(found)


class Store:
    """The documents of one station. Calls that write return a future that completes with the transaction."""

    def __init__(self, database: Database) -> None:
        self.database = database
        self._documents: OrderedDict[str, tuple[str, str, str, str]] = OrderedDict()
        """Rows of the latest documents, by digest: if the database has to begin anew, the next run needs them."""
        self.standing = KeyedTexts(database, "standing", key="key", patient=True)
        """The present activity of the station, which a restart resumes."""
        self.references = KeyedTexts(database, "board_references", key="board_type")
        self.methods = KeyedTexts(database, "board_methods", key="board_type", column="method")
        """The stitching methods of board types where they differ from the station's."""
        self.checks = CalibrationChecks(database, self.standing)
        self.identities, self.figures = RunIdentities(database), BoardFigures(database)
        self.search, self.retention = RunSearch(database), RunRetention(database)
        self.configurations = Configurations(database)

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
        self.database.execute(_KEEP_DOCUMENT, row, patient=True, durable=False, size=len(document))
        return digest

    def document(self, digest: str) -> str:
        """Return a stored board type or calibration; raise NotFoundError if the digest is unknown."""
        if (known := self._documents.get(digest)) is not None:
            return known[3]
        if (found := self.database.value("SELECT document FROM documents WHERE digest = ?", (digest,))) is None:
            raise NotFoundError(f"{self.database.path}: there is no document {digest}.")
        return str(found)

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
            connection.executemany(_KEEP_DOCUMENT, documents)
            # An update, not INSERT OR REPLACE, which would delete the row that results and checks refer to.
            # Callers wait for the end of a run; its result is replaced by the complete one a moment later.
            detail, times = packed(row.detail, QUICK), (None, None) if timeline is None else packed(timeline, QUICK)
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
                connection.execute("INSERT INTO results VALUES (?, ?, ?)", (row.id, *packed(result, QUICK)))
            if row.identity is not None:
                write_identity(connection, row.id, row.identity)

        size = len(row.summary) + len(row.detail) + len(row.head or "") + len(timeline or "") + len(result or "")
        # A run that begins need not survive a power failure: before its end there is nothing to announce.
        durable = row.finish_number is not None
        return self.database.write(write, patient=patient, durable=durable, size=size)

    def complete_result(self, run: str, document: str) -> Future[None]:
        """Write the complete result of a finished run in place of its first one; no effect if it was deleted."""

        def write(connection: sqlite3.Connection) -> None:
            # The trigger of the table refuses every update. Packing takes milliseconds, so that it is done here, in the
            # database's thread.
            replacement = "INSERT OR REPLACE INTO results SELECT run, ?, ? FROM results WHERE run = ?"
            connection.execute(replacement, (*packed(document), run))

        # What callers were told to be complete is so after a power cut too.
        return self.database.write(write, patient=True, size=len(document))

    def set_state(self, run: str, state: str) -> Future[int]:
        """Set the state of a finished run whose frames were released or evicted; no effect on an unfinished run."""
        # If the end of a run was never written, the next start must find it as unfinished.
        return self.database.execute(
            "UPDATE runs SET state = ? WHERE id = ? AND finish_number IS NOT NULL", (state, run),
            patient=True, durable=False, size=100,
        )  # fmt: skip

    def run(self, run: str) -> RunRow | None:
        """Return one run; None if it does not exist."""
        return self._first("WHERE id = ?", (run,))

    def runs(self, limit: int, before: str | None) -> list[RunRow]:
        """Return at most `limit` runs with ids below `before` (None: all), newest first. Details stay packed."""
        values = (before, before, limit)
        return self._rows("WHERE ? IS NULL OR id < ? ORDER BY id DESC LIMIT ?", values, unpack=False)

    def chosen_runs(self, ids: Sequence[str]) -> list[RunRow]:
        """Return the runs with these ids, newest first; ids that do not exist are left out. Details stay packed."""
        return self._rows(f"WHERE id {ANY_OF} ORDER BY id DESC", (keys_of(ids),), unpack=False)

    def unfinished(self) -> list[RunRow]:
        """Return the runs that were never finished, oldest first."""
        return self._rows("WHERE finish_number IS NULL ORDER BY id", ())

    def mark_frames_gone(self, gone: str) -> Future[int]:
        """Set the state of all finished runs with frames to `gone`, because their memory no longer exists."""
        # The condition on the state is that of the index `runs_with_frames`.
        return self.database.execute(
            """UPDATE runs SET state = ? WHERE state IN ('ready', 'degraded', 'failed')
               AND finish_number IS NOT NULL""",
            (gone,), patient=True,
        )  # fmt: skip

    def finished_after(self, finish_number: int) -> RunRow | None:
        """Return the run that finished next after `finish_number` (0: the first of all); None if there is none.

        Runs of which only a summary is kept are left out.
        """
        following = "SELECT run FROM whole_runs WHERE finish_number > ? ORDER BY finish_number LIMIT 1"
        return self._first(f"WHERE id = ({following})", (finish_number,))

    def last_finished(self) -> RunRow | None:
        """Return the run of this station that finished last; None before the first."""
        # Runs that were imported have numbers below 0.
        return self._first("WHERE finish_number > 0 ORDER BY finish_number DESC LIMIT 1", ())

    def newest_run(self) -> str | None:
        """Return the highest run id in use; None before the first run."""
        newest: str | None = self.database.value("SELECT max(id) FROM runs")
        return newest

    def result(self, run: str) -> str | None:
        """Return the result of a run; None if it has none."""
        return self.database.text("SELECT document, packed FROM results WHERE run = ?", (run,))

    def timeline(self, run: str) -> str | None:
        """Return the timeline of a run; None if it has none yet."""
        query = "SELECT timeline, packed_timeline FROM runs WHERE id = ? AND timeline IS NOT NULL"
        return self.database.text(query, (run,))

    def heights(self, run: str) -> str | None:
        """Return the measured heights of a run; None if it has none."""
        return self.database.text("SELECT document, packed FROM heights WHERE run = ?", (run,))

    def save_heights(self, run: str, document: str) -> Future[int]:
        """Write the heights of a finished run; no effect if it has some, or if its result was deleted meanwhile."""
        return self.database.execute(
            """INSERT OR IGNORE INTO heights SELECT id, ?, ? FROM runs
               WHERE id = ? AND finish_number IS NOT NULL AND detail <> ''""",
            (*packed(document), run), patient=True, durable=False, size=len(document),
        )  # fmt: skip

    def parts(self, run: str) -> str | None:
        """Return the measures of the parts of a run; None if it has none."""
        return self.database.text("SELECT document, packed FROM parts WHERE run = ?", (run,))

    def save_parts(self, run: str, document: str) -> Future[int]:
        """Write the measures of parts of a finished run; no effect if its result was deleted meanwhile."""
        return self.database.execute(
            """INSERT OR REPLACE INTO parts SELECT id, ?, ? FROM runs
               WHERE id = ? AND finish_number IS NOT NULL AND detail <> ''""",
            (*packed(document), run), patient=True, durable=False, size=len(document),
        )  # fmt: skip

    def decisions(self, runs: Sequence[str]) -> dict[str, str]:
        """Return what persons have decided about some runs, by run id; runs without a decision are left out."""
        rows = self.database.read(f"SELECT run, document FROM decisions WHERE run {ANY_OF}", (keys_of(runs),))
        return {str(run): str(document) for run, document in rows}

    def save_decision(self, run: str, document: str) -> bool:
        """Write the decision about a run, in place of an earlier one; return False if the run is not stored.

        It waits until this is done. The decision is deleted with the summary of the run.
        """
        written = self.database.execute(
            """INSERT INTO decisions SELECT id, ? FROM runs WHERE id = ?
               ON CONFLICT (run) DO UPDATE SET document = excluded.document""",
            (document, run),
        )
        return written.result() == 1

    def add_event(self, number: int, document: str) -> Future[None]:
        """Append an event, and delete the oldest beyond `EVENTS_KEPT`."""

        def write(connection: sqlite3.Connection) -> None:
            # A database that was restored from a backup may contain events with this number.
            connection.execute("INSERT OR REPLACE INTO events VALUES (?, ?)", (number, document))
            # Old events are deleted only once per 1000 events, so that the usual write concerns one row.
            if number % 1000 == 0:
                connection.execute("DELETE FROM events WHERE number <= ?", (number - EVENTS_KEPT,))

        return self.database.write(write, patient=True, durable=False, size=len(document))

    def events(self, after: int, limit: int) -> list[str]:
        """Return at most `limit` events numbered above `after`, oldest first."""
        query = "SELECT document FROM events WHERE number > ? ORDER BY number LIMIT ?"
        return self.database.column(query, (after, limit))

    def latest_events(self, kind: str, before: int) -> list[str]:
        """Return the latest event of each code of a kind, of those numbered below `before`."""
        query = """SELECT document, max(number) FROM events WHERE number < ? AND instr(document, ?)
                   AND json_valid(document) AND json_extract(document, '$.kind') = ?
                   GROUP BY json_extract(document, '$.code')"""
        return self.database.column(query, (before, f'"{kind}"', kind))

    def last_event(self) -> int:
        """Return the number of the newest event; 0 before the first."""
        return int(self.database.value("SELECT coalesce(max(number), 0) FROM events"))

    def close(self) -> None:
        """Finish all writes and close the file."""
        self.database.close()

    def _first(self, condition: str, values: tuple[object, ...]) -> RunRow | None:
        return next(iter(self._rows(condition, values)), None)

    def _rows(self, condition: str, values: tuple[object, ...], *, unpack: bool = True) -> list[RunRow]:
        found = []
        for *known, head, content in self.database.read(f"SELECT {_COLUMNS} FROM runs {condition}", values):
            if unpack:
                # A damaged text is shown as a record that cannot be read: no single row may stop a start.
                with suppress(sqlite3.DatabaseError):
                    known[-1] = unpacked(known[-1], content)
            run, state, finish_number, board_type, calibration, summary, detail = known
            found.append(RunRow(run, state, finish_number, board_type, calibration, summary, detail, head))
        return found


_KEEP_DOCUMENT = "INSERT OR IGNORE INTO documents VALUES (?, ?, ?, ?)"
_COLUMNS = "id, state, finish_number, board_type_digest, calibration_digest, summary, detail, head, packed_detail"
