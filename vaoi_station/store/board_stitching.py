"""How board types are stitched: the reference each was taught, and its way to stitch, if it has one of its own."""

from __future__ import annotations

import sqlite3
from concurrent.futures import Future

from vaoi_station.store.database import Database

_TABLES = ("board_references", "board_methods")


class BoardStitching:
    """What is chosen per board type beside its file; methods that write return a future that is done on disk."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def reference(self, board_type: str) -> str | None:
        """The document of a board type's reference; None if it has none."""
        rows = self._database.read("SELECT document FROM board_references WHERE board_type = ?", (board_type,))
        return str(rows[0]["document"]) if rows else None

    def references(self) -> list[str]:
        """The documents of all references."""
        return [str(row["document"]) for row in self._database.read("SELECT document FROM board_references")]

    def keep_reference(self, board_type: str, document: str) -> Future[None]:
        """Give a board type a reference in place of the one it has."""

        def write(connection: sqlite3.Connection) -> None:
            connection.execute("INSERT OR REPLACE INTO board_references VALUES (?, ?)", (board_type, document))

        return self._database.write(write)

    def drop_reference(self, board_type: str) -> Future[None]:
        """A board type has no reference any more; harmless if it had none."""
        return self._drop("board_references", board_type)

    def method(self, board_type: str) -> str | None:
        """The board type's own way to stitch; None if the station's holds."""
        rows = self._database.read("SELECT method FROM board_methods WHERE board_type = ?", (board_type,))
        return str(rows[0]["method"]) if rows else None

    def keep_method(self, board_type: str, method: str) -> Future[None]:
        """Give a board type a way of its own."""

        def write(connection: sqlite3.Connection) -> None:
            connection.execute("INSERT OR REPLACE INTO board_methods VALUES (?, ?)", (board_type, method))

        return self._database.write(write)

    def drop_method(self, board_type: str) -> Future[None]:
        """The station's way holds again."""
        return self._drop("board_methods", board_type)

    def _drop(self, table: str, board_type: str) -> Future[None]:
        assert table in _TABLES

        def write(connection: sqlite3.Connection) -> None:
            connection.execute(f"DELETE FROM {table} WHERE board_type = ?", (board_type,))

        return self._database.write(write)
