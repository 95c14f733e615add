"""Stitching settings per board type: its reference, and its stitching method where it differs from the station's."""

from __future__ import annotations

import sqlite3
from concurrent.futures import Future

from vaoi_station.store.database import Database

_TABLES = ("board_references", "board_methods")


class BoardStitching:
    """References and stitching methods of board types. Calls that write return a future of the transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def reference(self, board_type: str) -> str | None:
        """Return the reference document of a board type; None if it has no reference."""
        rows = self._database.read("SELECT document FROM board_references WHERE board_type = ?", (board_type,))
        return str(rows[0]["document"]) if rows else None

    def references(self) -> list[str]:
        """Return the documents of all references."""
        return [str(row["document"]) for row in self._database.read("SELECT document FROM board_references")]

    def keep_reference(self, board_type: str, document: str) -> Future[None]:
        """Set the reference of a board type, replacing an earlier one."""

        def write(connection: sqlite3.Connection) -> None:
            connection.execute("INSERT OR REPLACE INTO board_references VALUES (?, ?)", (board_type, document))

        return self._database.write(write)

    def drop_reference(self, board_type: str) -> Future[None]:
        """Delete the reference of a board type; no effect if it has none."""
        return self._drop("board_references", board_type)

    def method(self, board_type: str) -> str | None:
        """Return the stitching method of a board type; None if the station's default applies."""
        rows = self._database.read("SELECT method FROM board_methods WHERE board_type = ?", (board_type,))
        return str(rows[0]["method"]) if rows else None

    def keep_method(self, board_type: str, method: str) -> Future[None]:
        """Set the stitching method of a board type."""

        def write(connection: sqlite3.Connection) -> None:
            connection.execute("INSERT OR REPLACE INTO board_methods VALUES (?, ?)", (board_type, method))

        return self._database.write(write)

    def drop_method(self, board_type: str) -> Future[None]:
        """Delete the stitching method of a board type, so that the station's default applies."""
        return self._drop("board_methods", board_type)

    def _drop(self, table: str, board_type: str) -> Future[None]:
        # SQLite cannot take a table name as a parameter; the fixed set of names prevents injected text in the
        # statement.
        assert table in _TABLES

        def write(connection: sqlite3.Connection) -> None:
            connection.execute(f"DELETE FROM {table} WHERE board_type = ?", (board_type,))

        return self._database.write(write)
