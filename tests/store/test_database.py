"""One writer, many readers, and files that are not a database."""

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


def test_writes_are_carried_out_in_order(database: Database) -> None:
    futures = [database.write(partial(add_event, number=n)) for n in range(1, 50)]
    assert [f.result(10) for f in futures] == list(range(1, 50))
    assert database.read("SELECT count(*) AS n FROM events")[0]["n"] == 49


def test_a_failed_write_is_rolled_back_and_the_next_succeeds(database: Database) -> None:
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


def test_a_closed_database_refuses_reads_and_writes(database: Database) -> None:
    database.close()
    database.close()
    with pytest.raises(StateError, match="is closed"):
        database.write(lambda c: add_event(c, 1))
    with pytest.raises(StateError, match="is closed"):
        database.read("SELECT 1")


def test_the_write_ahead_log_is_on_and_the_version_is_stored(database: Database) -> None:
    assert database.read("PRAGMA journal_mode")[0][0] == "wal"
    assert database.read("PRAGMA user_version")[0][0] == VERSION


@pytest.mark.parametrize(
    "content", [b"this is no database, whatever its name may say" * 100, b"SQLite format 3\0" * 300]
)
def test_a_file_that_is_not_a_database_is_refused_and_left_unchanged(path: Path, content: bytes) -> None:
    path.parent.mkdir()
    path.write_bytes(content)
    with pytest.raises(DeviceError, match=r"station.db: is not a sound database") as refusal:
        Database(path)
    assert "backup" in refusal.value.action
    assert path.read_bytes() == content


def test_a_database_with_damaged_pages_is_refused(path: Path) -> None:
    database = Database(path)
    for number in range(1, 400):
        database.write(partial(add_event, number=number, document="x" * 200))
    database.close()
    content = bytearray(path.read_bytes())
    content[8192:40960] = bytes(b ^ 0x5A for b in content[8192:40960])
    path.write_bytes(bytes(content))
    with pytest.raises(DeviceError, match="not a sound database"):
        Database(path)


def test_a_database_of_a_newer_version_is_refused(path: Path) -> None:
    Database(path).close()
    connection = sqlite3.connect(path)
    connection.execute(f"PRAGMA user_version = {VERSION + 3}")
    connection.close()
    with pytest.raises(InputError, match=rf"has version {VERSION + 3} .* versions up to {VERSION}\."):
        Database(path)


def test_a_path_that_cannot_be_opened_is_refused(tmp_path: Path) -> None:
    (tmp_path / "station.db").mkdir()
    with pytest.raises(DeviceError, match="cannot be used"):
        Database(tmp_path / "station.db")


def test_closing_finishes_the_writes_that_were_submitted(path: Path) -> None:
    database = Database(path)
    futures = [database.write(partial(add_event, number=n)) for n in range(1, 200)]
    database.close()
    assert all(future.done() for future in futures)
    again = Database(path)
    assert again.read("SELECT count(*) AS n FROM events")[0]["n"] == 199
    again.close()


def test_an_error_of_the_callers_code_is_rolled_back_and_passed_on(database: Database) -> None:
    def wrong(connection: sqlite3.Connection) -> None:
        add_event(connection, 1)
        raise ValueError("not an SQLite error")

    with pytest.raises(ValueError, match="not an SQLite error"):
        database.write(wrong).result(10)
    assert database.read("SELECT number FROM events") == []


def test_a_query_with_an_error_names_the_file(database: Database) -> None:
    with pytest.raises(DeviceError, match=r"station\.db: cannot be used"):
        database.read("SELECT nothing FROM nowhere")
    assert database.read("SELECT 1 AS one")[0]["one"] == 1
