"""One writer, many readers, and files that are no sound database."""

from __future__ import annotations

import sqlite3
import threading
from functools import partial
from pathlib import Path

import pytest

from vaoi_station.errors import DeviceError, InputError, InternalError, StateError
from vaoi_station.store import Database
from vaoi_station.store.schema import VERSION


def add_event(connection: sqlite3.Connection, number: int, document: str = "{}") -> int:
    connection.execute("INSERT INTO events VALUES (?, ?)", (number, document))
    return number


def test_writes_are_done_in_order_and_answered(database: Database) -> None:
    futures = [database.write(partial(add_event, number=n)) for n in range(1, 50)]
    assert [f.result(10) for f in futures] == list(range(1, 50))
    assert database.read("SELECT count(*) AS n FROM events")[0]["n"] == 49


def test_a_write_that_fails_is_undone_told_and_the_next_succeeds(database: Database) -> None:
    def half(connection: sqlite3.Connection) -> None:
        add_event(connection, 1)
        add_event(connection, 1)

    with pytest.raises(InternalError, match="UNIQUE"):
        database.write(half).result(10)
    assert database.write(lambda c: add_event(c, 1)).result(10) == 1


def test_readers_do_not_wait_for_the_writer(database: Database) -> None:
    inside, go_on = threading.Event(), threading.Event()

    def slow(connection: sqlite3.Connection) -> None:
        add_event(connection, 1)
        inside.set()
        assert go_on.wait(20)

    pending = database.write(slow)
    assert inside.wait(20)
    counts: list[int] = []
    readers = [
        threading.Thread(target=lambda: counts.append(database.read("SELECT count(*) AS n FROM events")[0]["n"]))
        for _ in range(12)
    ]
    for reader in readers:
        reader.start()
    for reader in readers:
        reader.join(20)
    assert counts == [0] * 12
    go_on.set()
    pending.result(20)
    assert database.read("SELECT count(*) AS n FROM events")[0]["n"] == 1


def test_closed_means_closed(database: Database) -> None:
    database.close()
    database.close()
    with pytest.raises(StateError, match="is closed"):
        database.write(lambda c: add_event(c, 1))
    with pytest.raises(StateError, match="is closed"):
        database.read("SELECT 1")


def test_the_write_ahead_log_is_on_and_the_version_is_noted(database: Database) -> None:
    assert database.read("PRAGMA journal_mode")[0][0] == "wal"
    assert database.read("PRAGMA user_version")[0][0] == VERSION


@pytest.mark.parametrize(
    "content", [b"this is no database, whatever its name may say" * 100, b"SQLite format 3\0" * 300]
)
def test_a_file_that_is_no_database(path: Path, content: bytes) -> None:
    path.parent.mkdir()
    path.write_bytes(content)
    with pytest.raises(DeviceError, match=r"station.db: is not a sound database") as refusal:
        Database(path)
    assert "backup" in refusal.value.action
    assert path.read_bytes() == content


def test_a_database_whose_pages_are_damaged(path: Path) -> None:
    database = Database(path)
    for number in range(1, 400):
        database.write(partial(add_event, number=number, document="x" * 200))
    database.close()
    content = bytearray(path.read_bytes())
    content[8192:40960] = bytes(b ^ 0x5A for b in content[8192:40960])
    path.write_bytes(bytes(content))
    with pytest.raises(DeviceError, match="not a sound database"):
        Database(path)


def test_a_database_of_a_newer_version_is_refused_by_name(path: Path) -> None:
    Database(path).close()
    connection = sqlite3.connect(path)
    connection.execute(f"PRAGMA user_version = {VERSION + 3}")
    connection.close()
    with pytest.raises(InputError, match=f"has version {VERSION + 3} of the tables, this software knows {VERSION}"):
        Database(path)


def test_a_directory_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "station.db").mkdir()
    with pytest.raises(DeviceError, match="cannot be used"):
        Database(tmp_path / "station.db")
