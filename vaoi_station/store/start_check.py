"""The check of a small database file before the station starts."""

from __future__ import annotations

import sqlite3
from pathlib import Path

LARGEST_AT_START = 50_000_000
"""Largest file in bytes that is checked completely at the start; measured, that takes a second from a cold disk."""


def check_at_start(connection: sqlite3.Connection, path: Path) -> None:
    """Check a small database completely; leave a large one to `DatabaseCheck`. Raise DatabaseError if it is damaged."""
    if path.stat().st_size > LARGEST_AT_START:
        return
    fault = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
    if fault != "ok":
        raise sqlite3.DatabaseError(fault)
