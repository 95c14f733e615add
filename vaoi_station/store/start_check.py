"""The check of a small database file before the station starts."""

from __future__ import annotations

import sqlite3
from pathlib import Path

LARGEST_AT_START = 50_000_000
"""Largest file in bytes that is checked completely at the start. From a cold disk, this took one second."""


def check_at_start(connection: sqlite3.Connection, path: Path) -> None:
    """Check a small database completely, and raise DatabaseError if it is damaged.

    `DatabaseCheck` checks a large one.
    """
    if path.stat().st_size > LARGEST_AT_START:
        return
    fault = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
    if fault != "ok":
        raise sqlite3.DatabaseError(fault)
