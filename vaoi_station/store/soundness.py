"""Checks in small steps, while the station runs, whether the database file is undamaged.

SQLite's `quick_check` reads every page and cannot be interrupted. A database of a year would delay the start by more
than the time that the station may take (`check_at_start`), so its rows are read later, a few at a time.
"""

from __future__ import annotations

import json
import sqlite3

from vaoi_station.errors import DeviceError
from vaoi_station.store.database import Database
from vaoi_station.store.schema import unpacked

ROWS, LARGE_ROWS = 400, 25
"""Numbers of rows per step: for tables with small rows, and for tables whose rows may have megabytes."""
PAUSE_STEPS = 100_000
"""Number of steps without a check between two rounds. With 0.2 s per step, this is 5.6 hours."""
RESTORE = "Stop the station and restore a backup (vaoi restore), or move the file away to begin with an empty one."

_TABLES: tuple[tuple[str, str, str, str, int], ...] = (
    ("runs", "id", "json_valid(summary) AND (detail IN ('', 'packed') OR json_valid(detail))", "NULL", ROWS),
    ("runs", "id", "(packed_detail IS NOT NULL) = (detail = 'packed')", "packed_detail", LARGE_ROWS),
    ("runs", "id", "coalesce(timeline, 'packed') = 'packed' OR json_valid(timeline)", "packed_timeline", LARGE_ROWS),
    ("results", "run", "packed IS NOT NULL OR json_valid(document)", "packed", LARGE_ROWS),
    ("heights", "run", "packed IS NOT NULL OR json_valid(document)", "packed", LARGE_ROWS),
    ("identities", "run", "packed IS NOT NULL OR json_valid(document)", "packed", ROWS),
    ("board_ids", "run", "board_id IS NOT NULL", "NULL", ROWS),
    ("calibration_checks", "run", "json_valid(document)", "NULL", ROWS),
    ("documents", "digest", "json_valid(document)", "NULL", LARGE_ROWS),
    ("board_references", "board_type", "json_valid(document)", "NULL", LARGE_ROWS),
    ("whole_runs", "run", "finish_number <> 0", "NULL", ROWS),
    ("board_figures", "run", "json_valid(document)", "NULL", ROWS),
    ("hourly_figures", "number", "json_valid(document)", "NULL", ROWS),
    ("figure_marks", "number", "kind <> ''", "NULL", ROWS),
    ("events", "number", "json_valid(document)", "NULL", ROWS),
)
"""Table, key, condition that a sound row fulfils, packed text, and number of rows of a step.

Every column with text is read. A packed text has a check sum of its own.
"""


class DatabaseCheck:
    """Reads the whole database in small steps, in one round after another."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._table, self._after, self._left_out = 0, "", 0
        self.rounds = 0
        """Number of rounds through the whole database in which no damage was found."""

    def step(self) -> None:
        """Read the next rows.

        Raises:
            DeviceError: the file is damaged. The next step continues after the damaged place.
        """
        if self._left_out:
            self._left_out -= 1
            return
        table, key, sound, content, rows = _TABLES[self._table]
        # The key "number" is a number, which SQLite compares with a text as smaller: the first value must be one too.
        after: str | int = self._after or (-1 if key == "number" else "")
        try:
            found = self._database.read(
                f"""SELECT {key} AS k, {sound} AS sound, {content} AS content FROM {table}
                    WHERE {key} > ? ORDER BY {key} LIMIT ?""",
                (int(after) if key == "number" else after, rows),
            )
        except DeviceError as error:
            self._next_table()
            raise DeviceError(
                f"{error.message} The damage is in table {table} after {after!r}.",
                action=RESTORE,
                code="database-damaged",
            ) from error
        if len(found) < rows:
            self._next_table()
        else:
            self._after = str(found[-1]["k"])
        if bad := [str(row["k"]) for row in found if not (row["sound"] and _unpacks(row["content"]))]:
            raise DeviceError(
                f"{self._database.path}: table {table} has damaged rows ({', '.join(bad[:3])}).",
                action=RESTORE,
                code="database-damaged",
            )

    def _next_table(self) -> None:
        self._table, self._after = self._table + 1, ""
        if self._table == len(_TABLES):
            self._table, self._left_out = 0, PAUSE_STEPS
            self.rounds += 1


def _unpacks(content: bytes | None) -> bool:
    try:
        return json.loads(unpacked("{}", content)) is not None
    except (sqlite3.DatabaseError, ValueError):
        return False
