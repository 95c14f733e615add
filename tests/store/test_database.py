"""One writer, many readers, and files that are not a database."""

from __future__ import annotations

import sqlite3
import threading
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.store.conftest import unreachable
from vaoi_station.errors import DeviceError, InternalError, NotFoundError, StateError
from vaoi_station.store import Database
from vaoi_station.store import database as module
from vaoi_station.store.database_file import open_database
from vaoi_station.store.storage_trouble import StorageTrouble


def add_event(connection: sqlite3.Connection, number: int, document: str = "{}") -> int:
    connection.execute("INSERT INTO events VALUES (?, ?)", (number, document))
    return number


def fill(database: Database) -> None:
    """Let the file grow no further: SQLite then reports what it reports on a full disk."""
    database.write(lambda c: c.execute("PRAGMA max_page_count = 1").fetchall()).result(20)


def make_room(database: Database) -> None:
    assert database._writer is not None
    database._writer.execute("PRAGMA max_page_count = 1000000").fetchall()


def test_a_failed_write_is_rolled_back_and_the_next_succeeds(database: Database) -> None:
    def half(connection: sqlite3.Connection) -> None:
        add_event(connection, 1)
        add_event(connection, 1)

    with pytest.raises(InternalError, match="UNIQUE"):
        database.write(half).result(10)
    assert database.write(lambda c: add_event(c, 1)).result(10) == 1


def test_an_error_of_the_callers_code_is_rolled_back_and_passed_on(database: Database) -> None:
    def wrong(connection: sqlite3.Connection) -> None:
        add_event(connection, 1)
        raise ValueError("not an SQLite error")

    with pytest.raises(ValueError, match="not an SQLite error"):
        database.write(wrong).result(10)
    assert database.read("SELECT number FROM events") == []


@pytest.mark.parametrize(("durable", "level"), [(True, 2), (False, 1)])
def test_a_durable_write_waits_for_the_disk(database: Database, durable: bool, level: int) -> None:
    """Level 2 is FULL: the log is on the disk when the transaction ends."""
    database.write(lambda c: add_event(c, 1), durable=not durable).result(10)
    done = database.write(lambda c: c.execute("PRAGMA synchronous").fetchone()[0], durable=durable)
    assert done.result(10) == level


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


@pytest.mark.parametrize(
    "content", [b"this is no database, whatever its name may say" * 100, b"SQLite format 3\0" * 300]
)
def test_a_file_that_is_not_a_database_is_set_aside_unchanged(path: Path, content: bytes) -> None:
    path.parent.mkdir()
    path.write_bytes(content)
    database = Database(path)
    [notice] = database.notices
    assert notice.code == "database-damaged"
    assert database.write(lambda c: add_event(c, 1)).result(10) == 1
    [kept] = path.parent.glob("station.db.damaged-*")
    assert kept.name in notice.message
    assert kept.read_bytes() == content
    database.close()


def damage(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[8192:400_000] = bytes(b ^ 0x5A for b in content[8192:400_000])
    path.write_bytes(bytes(content))


def test_a_database_with_damaged_pages_is_set_aside(path: Path) -> None:
    database = Database(path)
    for number in range(1, 400):
        database.write(partial(add_event, number=number, document="x" * 200))
    database.close()
    damage(path)
    again = Database(path)
    assert [notice.code for notice in again.notices] == ["database-damaged"]
    assert again.read("SELECT count(*) AS n FROM events")[0]["n"] == 0
    again.close()
    third = Database(path)
    [earlier] = third.notices
    assert (earlier.code, earlier.kept) == ("database-damaged", again.notices[0].kept), "the warning survives a start"
    assert earlier.kept is not None
    earlier.kept.unlink()
    patience = threading.Event()
    while third.notices:  # it ends while the station runs, too
        assert not patience.wait(0.05)
    third.close()


def test_damage_that_a_read_meets_sets_the_database_aside_and_writes_go_on(path: Path) -> None:
    database = Database(path)
    for number in range(1, 400):
        database.write(partial(add_event, number=number, document="x" * 2000))
    database.close()
    again = Database(path)
    damage(path)
    with pytest.raises(DeviceError, match="not a sound database") as refusal:
        again.read("SELECT sum(length(document)) FROM events")
    assert refusal.value.code == "database-damaged"
    assert again.write(lambda c: add_event(c, 400), patient=True).result(20) == 400
    assert [notice.code for notice in again.notices] == ["database-damaged"]
    assert [row["number"] for row in again.read("SELECT number FROM events")] == [400]
    again.close()


def test_a_full_disk_is_named_and_what_waits_is_written_in_order_when_there_is_room(database: Database) -> None:
    fill(database)
    refused = database.write(partial(add_event, number=1, document="x" * 50_000))
    with pytest.raises(DeviceError, match="database or disk is full") as refusal:
        refused.result(20)
    assert refusal.value.code == "storage-full"
    assert database.trouble is not None
    assert database.trouble.code == "storage-full"
    waiting = [database.write(partial(add_event, number=n, document="x" * 9000), patient=True) for n in range(2, 9)]
    with pytest.raises(DeviceError, match="full"):
        database.write(partial(add_event, number=9)).result(20)
    assert not any(future.done() for future in waiting)
    make_room(database)
    assert [future.result(20) for future in waiting] == [*range(2, 9)]
    assert database.trouble is None


def test_trouble_ends_by_itself_although_nothing_waits(database: Database) -> None:
    fill(database)
    with pytest.raises(DeviceError):
        database.write(partial(add_event, number=1, document="x" * 50_000)).result(20)
    make_room(database)
    ended = threading.Event()
    while database.trouble is not None:
        assert not ended.wait(0.05)
    assert database.write(lambda c: add_event(c, 1)).result(20) == 1


def test_memory_for_waiting_writes_is_bounded(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_WAITING_BYTES", 100_000)
    fill(database)
    big = [
        database.write(partial(add_event, number=n, document="x" * 30_000), patient=True, size=30_000)
        for n in range(1, 9)
    ]
    with pytest.raises(DeviceError, match="wait in memory"):
        big[-1].result(20)
    database.close()
    assert all(future.exception() is not None for future in big), "what the disk refuses at the end is given up"


@pytest.mark.parametrize("companions", [False, True])
def test_a_database_that_is_deleted_while_it_is_open_is_written_back(path: Path, companions: bool) -> None:
    database = Database(path)
    for number in range(1, 30):
        database.write(partial(add_event, number=number)).result(20)
    path.unlink()
    if companions:
        for ending in ("-wal", "-shm"):
            path.with_name(path.name + ending).unlink()
    assert database.write(lambda c: add_event(c, 30), patient=True).result(20) == 30
    assert [notice.code for notice in database.notices] == ["database-deleted"]
    assert database.read("SELECT count(*) AS n FROM events")[0]["n"] == 30
    database.close()
    again = Database(path)
    assert again.read("SELECT count(*) AS n FROM events")[0]["n"] == 30
    assert again.notices == ()
    again.close()


def test_a_database_that_is_replaced_while_it_is_open_is_kept_beside(path: Path, tmp_path: Path) -> None:
    other = Database(tmp_path / "other.db")
    other.write(lambda c: add_event(c, 77)).result(20)
    other.close()
    database = Database(path)
    database.write(lambda c: add_event(c, 1)).result(20)
    (tmp_path / "other.db").replace(path)
    database.write(lambda c: add_event(c, 78), patient=True).result(20)
    assert [row["number"] for row in database.read("SELECT number FROM events")] == [77, 78]
    [notice] = database.notices
    assert notice.code == "database-replaced"
    [kept] = path.parent.glob("station.db.replaced-*")
    saved = sqlite3.connect(kept)
    assert saved.execute("SELECT number FROM events").fetchall() == [(1,)]
    saved.close()
    database.close()


def test_an_idle_database_notices_by_itself_that_its_file_was_deleted(path: Path) -> None:
    database = Database(path)
    path.unlink()
    waiting = threading.Event()
    while not database.notices:
        assert not waiting.wait(0.05)
    assert path.exists()
    database.close()


def test_a_lost_directory_is_waited_for(path: Path) -> None:
    database = Database(path)
    path.parent.rename(path.parent.with_name("elsewhere"))
    path.parent.write_text("in the way")
    pending = database.write(lambda c: add_event(c, 1), patient=True)
    waiting = threading.Event()
    while database.trouble is None:
        assert not waiting.wait(0.05)
    assert database.trouble.code == "storage-unavailable"
    path.parent.unlink()
    assert pending.result(20) == 1
    database.close()


def test_a_directory_that_cannot_be_searched_ends_neither_the_writing_thread_nor_the_history(path: Path) -> None:
    """As on a disk whose directory cannot be read any more; files that are open can still be used."""
    path.parent.mkdir()
    path.write_bytes(b"no database" * 100)
    database = Database(path)
    try:
        [notice] = database.notices
        with unreachable(path.parent):
            database._check_file()
            database.write(lambda c: add_event(c, 1), patient=True).result(20)
        assert (database.thread.fault(), database.notices) == (None, (notice,))
        assert database.write(lambda c: add_event(c, 2)).result(20) == 2
        assert [row["number"] for row in database.read("SELECT number FROM events")] == [1, 2]
        assert not list(path.parent.glob("*.replaced-*"))
    finally:
        database.close()


def test_a_write_that_does_not_end_is_trouble(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SLOW_S", 0.0)
    inside, go_on = threading.Event(), threading.Event()

    def slow(_: sqlite3.Connection) -> None:
        inside.set()
        assert go_on.wait(20)

    pending = database.write(slow)
    assert inside.wait(20)
    assert database.trouble is not None
    assert "has not ended" in database.trouble.message
    go_on.set()
    pending.result(20)


def test_closing_finishes_the_writes_that_were_submitted(path: Path) -> None:
    database = Database(path)
    futures = [database.write(partial(add_event, number=n)) for n in range(1, 200)]
    database.close()
    assert all(future.done() for future in futures)
    again = Database(path)
    assert again.read("SELECT count(*) AS n FROM events")[0]["n"] == 199
    again.close()


def test_a_start_on_a_disk_that_takes_nothing_reads_and_writes_once_there_is_room(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A real full disk: `tests/system/test_storage_troubles.py`."""
    first = Database(path)
    first.write(lambda c: add_event(c, 1)).result(20)
    first.close()
    refused = threading.Event()
    refused.set()

    def refuse(there: Path) -> Any:
        if refused.is_set():
            raise StorageTrouble("storage-full", "database or disk is full", "").error()
        return open_database(there)

    monkeypatch.setattr(module, "open_database", refuse)
    database = Database(path)
    assert (database.trouble is not None, database.history_unread) == (True, False)
    assert [row["number"] for row in database.read("SELECT number FROM events")] == [1]
    waiting = database.write(lambda c: add_event(c, 2), patient=True)
    with pytest.raises(DeviceError, match="full"):
        database.write(lambda c: add_event(c, 3)).result(20)
    assert not waiting.done()
    refused.clear()
    assert waiting.result(20) == 2
    assert [row["number"] for row in database.read("SELECT number FROM events")] == [1, 2]
    database.close()


def test_an_acknowledgement_holds_over_starts_and_ends_with_its_file(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"garbage " * 1000)
    first = Database(path)
    [notice] = first.notices
    assert notice.kept is not None
    with pytest.raises(NotFoundError, match="is no database that was set aside"):
        first.acknowledge(path.name)
    assert first.acknowledged == frozenset()
    first.acknowledge(notice.kept.name)
    assert first.acknowledged == {notice.kept}
    assert first.notices == (notice,), "references are kept as long as the file is there"
    first.close()
    again = Database(path)
    assert again.acknowledged == {notice.kept}
    again.close()
    notice.kept.unlink()
    Database(path).close()
    assert [p.name for p in path.parent.iterdir() if "damaged" in p.name] == []
