"""The tables as a list of migration steps; `PRAGMA user_version` holds the number of steps applied.

A released step is never edited. A change of the tables is added as a further step.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path

from vaoi_station.errors import InputError

# STRICT tables reject a value of the wrong type; without it SQLite stores text in an INTEGER column.
STEPS: tuple[tuple[str, ...], ...] = (
    (
        """CREATE TABLE documents (
            digest TEXT PRIMARY KEY,
            kind TEXT NOT NULL CHECK (kind IN ('board-type', 'calibration')),
            first_seen TEXT NOT NULL,
            document TEXT NOT NULL
        ) STRICT""",
        """CREATE TABLE runs (
            id TEXT PRIMARY KEY,
            state TEXT NOT NULL,
            finish_number INTEGER UNIQUE,
            board_type_digest TEXT NOT NULL REFERENCES documents (digest),
            calibration_digest TEXT NOT NULL REFERENCES documents (digest),
            summary TEXT NOT NULL,
            detail TEXT NOT NULL,
            head TEXT,
            timeline TEXT
        ) STRICT""",
        """CREATE TABLE results (
            run TEXT PRIMARY KEY REFERENCES runs (id),
            document TEXT NOT NULL
        ) STRICT""",
        """CREATE TRIGGER results_are_immutable BEFORE UPDATE ON results
            BEGIN SELECT RAISE (ABORT, 'a result never changes'); END""",
        """CREATE TABLE events (
            number INTEGER PRIMARY KEY,
            document TEXT NOT NULL
        ) STRICT""",
    ),
    (
        """CREATE TABLE calibration_checks (
            run TEXT PRIMARY KEY REFERENCES runs (id),
            calibration_digest TEXT NOT NULL REFERENCES documents (digest),
            document TEXT NOT NULL
        ) STRICT""",
        "CREATE INDEX calibration_checks_in_order ON calibration_checks (calibration_digest, run)",
    ),
    (
        """CREATE TABLE board_references (
            board_type TEXT PRIMARY KEY,
            document TEXT NOT NULL
        ) STRICT""",
        """CREATE TABLE board_methods (
            board_type TEXT PRIMARY KEY,
            method TEXT NOT NULL
        ) STRICT""",
    ),
)
VERSION = len(STEPS)


def migrate(connection: sqlite3.Connection, path: Path) -> None:
    """Apply the missing migration steps, each in one transaction.

    Raises:
        InputError: the database was written by a newer version.
    """
    (found,) = connection.execute("PRAGMA user_version").fetchone()
    if found > VERSION:
        raise InputError(
            f"{path}: has version {found} of the tables; this software knows versions up to {VERSION}.",
            action="Start the newer vaoi_station that wrote it, or give this one another data directory.",
        )
    for number in range(found, VERSION):
        # Tables and version number change together, so that an interrupted migration continues at the next start.
        connection.execute("BEGIN IMMEDIATE")
        try:
            for statement in STEPS[number]:
                connection.execute(statement)
            connection.execute(f"PRAGMA user_version = {number + 1}")
            connection.execute("COMMIT")
        except BaseException:  # roll back in every case; the error is raised again
            connection.execute("ROLLBACK")
            raise
