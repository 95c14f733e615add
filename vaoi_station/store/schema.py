"""The tables, and the steps from one version of them to the next; `PRAGMA user_version` holds the version.

A released step is never edited. A change of the tables is added as a further step.
"""

from __future__ import annotations

import json
import sqlite3
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from vaoi_station.errors import InputError

_VERDICT = "CASE WHEN json_valid(new.summary) THEN json_extract(new.summary, '$.verdict') END"
DOUBTFUL = f"(coalesce({_VERDICT}, '') <> 'ok')"
"""SQL expression: 1 for a run with a verdict other than ok, or without a verdict; 0 for all other runs."""

_TABLES = f"""
CREATE TABLE documents (
    digest TEXT PRIMARY KEY,
    kind TEXT NOT NULL CHECK (kind IN ('board-type', 'calibration')),
    first_seen TEXT NOT NULL,
    document TEXT NOT NULL
) STRICT;
CREATE TABLE runs (
    id TEXT PRIMARY KEY,
    state TEXT NOT NULL,
    finish_number INTEGER UNIQUE,
    board_type_digest TEXT NOT NULL REFERENCES documents (digest),
    calibration_digest TEXT NOT NULL REFERENCES documents (digest),
    summary TEXT NOT NULL,
    detail TEXT NOT NULL,
    head TEXT,
    timeline TEXT,
    packed_detail BLOB,
    packed_timeline BLOB
) STRICT;
-- To find, and to delete, documents to which no run refers, without reading the runs of a year.
CREATE INDEX runs_by_board_type ON runs (board_type_digest);
CREATE INDEX runs_by_calibration ON runs (calibration_digest);
-- A start that changes the state of runs must not have to read all runs of a year.
CREATE INDEX runs_with_frames ON runs (state) WHERE state IN ('ready', 'degraded', 'failed');
CREATE TABLE results (run TEXT PRIMARY KEY REFERENCES runs (id), document TEXT NOT NULL, packed BLOB) STRICT;
CREATE TRIGGER results_are_immutable BEFORE UPDATE ON results
    BEGIN SELECT RAISE (ABORT, 'a result never changes'); END;
-- Heights are measured after the result is written, which never changes.
CREATE TABLE heights (run TEXT PRIMARY KEY REFERENCES runs (id), document TEXT NOT NULL, packed BLOB) STRICT;
CREATE TABLE events (number INTEGER PRIMARY KEY, document TEXT NOT NULL) STRICT;
CREATE TABLE calibration_checks (
    run TEXT PRIMARY KEY REFERENCES runs (id),
    calibration_digest TEXT NOT NULL REFERENCES documents (digest),
    document TEXT NOT NULL
) STRICT;
CREATE INDEX calibration_checks_in_order ON calibration_checks (calibration_digest, run);
CREATE TABLE board_references (board_type TEXT PRIMARY KEY, document TEXT NOT NULL) STRICT;
CREATE TABLE board_methods (board_type TEXT PRIMARY KEY, method TEXT NOT NULL) STRICT;
-- Which finished runs still have details and results (`retention.py`). Triggers fill it, so that no code that ends a
-- run can leave it out.
CREATE TABLE whole_runs (
    run TEXT PRIMARY KEY REFERENCES runs (id),
    finish_number INTEGER NOT NULL UNIQUE,
    doubtful INTEGER NOT NULL
) STRICT;
CREATE INDEX whole_runs_by_verdict ON whole_runs (doubtful, run);
CREATE TRIGGER run_is_whole AFTER INSERT ON runs WHEN new.finish_number IS NOT NULL
    BEGIN INSERT INTO whole_runs VALUES (new.id, new.finish_number, {DOUBTFUL}); END;
CREATE TRIGGER run_became_whole AFTER UPDATE OF finish_number ON runs
    WHEN old.finish_number IS NULL AND new.finish_number IS NOT NULL
    BEGIN INSERT INTO whole_runs VALUES (new.id, new.finish_number, {DOUBTFUL}); END;
CREATE TABLE pins (run TEXT PRIMARY KEY REFERENCES runs (id), pinned TEXT NOT NULL) STRICT;
-- One row: the highest id of the runs of which not even the summary is kept.
CREATE TABLE forgotten (last TEXT NOT NULL) STRICT;
CREATE TABLE configurations (
    digest TEXT PRIMARY KEY, first_seen TEXT NOT NULL, document TEXT NOT NULL, last_used TEXT
) STRICT;
CREATE TABLE standing (key TEXT PRIMARY KEY, document TEXT NOT NULL) STRICT;
CREATE TABLE decisions (run TEXT PRIMARY KEY REFERENCES runs (id) ON DELETE CASCADE, document TEXT NOT NULL) STRICT;
-- Identities are kept as long as the summaries of their runs, so that a board is found by its id.
CREATE TABLE identities (
    run TEXT PRIMARY KEY REFERENCES runs (id) ON DELETE CASCADE,
    document TEXT NOT NULL,
    packed BLOB,
    pending INTEGER NOT NULL DEFAULT 0
) STRICT;
CREATE INDEX identities_pending ON identities (run) WHERE pending;
CREATE TABLE board_ids (
    board_id TEXT NOT NULL,
    run TEXT NOT NULL REFERENCES runs (id) ON DELETE CASCADE,
    PRIMARY KEY (board_id, run)
) STRICT, WITHOUT ROWID;
CREATE INDEX board_ids_by_run ON board_ids (run);
-- Figures outlive the runs that they are of, so these tables do not refer to runs (`figures.py`).
CREATE TABLE board_figures (
    run TEXT PRIMARY KEY, started TEXT NOT NULL, board_type TEXT NOT NULL, document TEXT NOT NULL
) STRICT, WITHOUT ROWID;
CREATE INDEX board_figures_in_time ON board_figures (started, board_type);
CREATE TABLE hourly_figures (
    number INTEGER PRIMARY KEY,
    hour TEXT NOT NULL,
    board_type TEXT NOT NULL,
    document TEXT NOT NULL,
    UNIQUE (hour, board_type)
) STRICT;
CREATE TABLE figure_marks (
    number INTEGER PRIMARY KEY,
    kind TEXT NOT NULL,
    board_type TEXT NOT NULL,
    started TEXT NOT NULL,
    run TEXT NOT NULL,
    before TEXT,
    after TEXT NOT NULL
) STRICT;
CREATE INDEX figure_marks_by_kind ON figure_marks (kind, board_type);
"""
"""All tables of version 13. STRICT tables reject a value of the wrong type."""

_PARTS = """
CREATE TABLE parts (run TEXT PRIMARY KEY REFERENCES runs (id), document TEXT NOT NULL, packed BLOB) STRICT;
"""
"""Measures of the parts of runs."""

STEPS = {13: _TABLES, 14: _PARTS}
"""By version, the statements that make it from the version before; the first one begins with an empty file."""
OLDEST, VERSION = min(STEPS), max(STEPS)
PACKED = "packed"
"""Value of a text column whose text is stored, compressed, in the column beside it."""
_SMALLEST = 500
"""Shortest text that is packed, in characters."""
_LEVEL, QUICK = 6, 1
"""Effort of the compression; 9 takes twice the time for 1 % less. The second takes a fifth of the time, for an eighth
more of a result, and a quarter more of a timeline."""


ANY_OF = "IN (SELECT value FROM json_each(?))"
"""Condition of a query that a column has one of the keys of which `keys_of` made the value.

Each connection keeps the last 128 statements, by their text. With a `?` for every key, each number of keys would be a
statement of its own: those for 1 to 128 keys take 1.7 MB, one for 1000 keys 0.2 MB."""


def keys_of(keys: Sequence[str] | Sequence[int]) -> str:
    """Return the value of `ANY_OF` for these keys."""
    return json.dumps(list(keys))


def packed(text: str, level: int = _LEVEL) -> tuple[str, bytes | None]:
    """Return the values with which a text is stored: that of its text column, and that of the column beside it.

    A long text is compressed. Its text column then holds `PACKED`, and the other column the compressed text."""
    return (text, None) if len(text) < _SMALLEST else (PACKED, zlib.compress(text.encode(), level))


def unpacked(text: str, content: bytes | None) -> str:
    """Return a text from the two values that `packed` returned for it. Raise DatabaseError if it is damaged."""
    if content is None:
        return text
    try:
        return zlib.decompress(content).decode()
    except (zlib.error, ValueError) as error:
        raise sqlite3.DatabaseError(f"a packed text is damaged ({error})") from error


def migrate(connection: sqlite3.Connection, path: Path) -> None:
    """Apply the missing migration steps, each in one transaction. InputError: the version is newer, or too old."""
    (found,) = connection.execute("PRAGMA user_version").fetchone()
    if found > VERSION:
        raise InputError(
            f"{path}: has version {found} of the tables; this software knows versions up to {VERSION}.",
            action="Start the newer vaoi_station that wrote it, or give this one another data directory.",
            code="database-newer",
        )
    if 0 < found < OLDEST:
        raise InputError(
            f"{path}: has version {found} of the tables; this software knows versions from {OLDEST} on.",
            action="Restore a backup of this version, or move the file away: the history then begins anew.",
            code="database-foreign",
        )
    for version in (v for v in sorted(STEPS) if v > found):
        # Tables and version number change together, so that an interrupted migration continues at the next start.
        connection.execute("BEGIN IMMEDIATE")
        try:
            for statement in statements_of(STEPS[version]):
                connection.execute(statement)
            connection.execute(f"PRAGMA user_version = {version}")
            connection.execute("COMMIT")
        except BaseException:  # roll back in every case, then raise the error again
            # After "disk full", SQLite has rolled back already; a second ROLLBACK would hide that cause.
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise


def statements_of(script: str) -> Iterator[str]:
    """Yield the statements of a script; `executescript` would end the transaction."""
    statement = ""
    for line in script.splitlines():
        statement += f"{line}\n"
        if sqlite3.complete_statement(statement):
            yield statement
            statement = ""
