"""What a start finds in place of the database, and what it makes of it."""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path

import pytest

from vaoi_station.errors import DeviceError, InputError
from vaoi_station.store import Database
from vaoi_station.store.database_file import (
    earlier_notices,
    is_empty,
    open_database,
    rescue,
    set_aside,
    stand_in,
)
from vaoi_station.store.storage_trouble import StorageTrouble


def opened(path: Path) -> str | None:
    """Open and close; return the code of what was found."""
    connection, notice = open_database(path)
    connection.close()
    return None if notice is None else notice.code


def test_a_database_that_was_deleted_or_emptied_between_two_starts_is_reported(path: Path) -> None:
    opened(path)
    path.unlink()
    assert opened(path) == "database-deleted"
    path.write_bytes(b"x")
    assert opened(path) == "database-deleted"
    assert opened(path) is None
    assert [notice.code for notice in earlier_notices(path)] == ["database-deleted"] * 2
    for mark in path.parent.glob("station.db.deleted-*"):
        mark.unlink()
    assert earlier_notices(path) == ()


@pytest.mark.parametrize("size", [100, 4096, 5000])
def test_a_database_that_was_cut_is_set_aside(path: Path, size: int) -> None:
    opened(path)
    os.truncate(path, size)
    assert opened(path) == "database-damaged"
    [kept] = path.parent.glob("station.db.damaged-*")
    assert kept.stat().st_size == size


def test_a_large_file_is_written_back_with_a_heartbeat(path: Path) -> None:
    connection, _ = open_database(path)
    connection.executemany("INSERT INTO events VALUES (?, '{}')", ((n,) for n in range(20_000)))
    beats = list[int]()
    path.unlink()
    rescue(connection, path, lambda: beats.append(1))
    connection.close()
    assert len(beats) > 5


def test_sets_of_damaged_files_of_one_second_do_not_overwrite_one_another(path: Path) -> None:
    path.parent.mkdir()
    for content in ("a", "b", "c"):
        path.write_text(content)
        path.with_name("station.db-wal").write_text(content)
        set_aside(path, "test")
    kept = sorted(p for p in path.parent.iterdir() if not p.name.endswith("-wal"))
    assert sorted(p.read_text() for p in kept) == ["a", "b", "c"]
    assert all(p.with_name(p.name + "-wal").read_text() == p.read_text() for p in kept)


def test_a_database_of_another_program_is_refused_and_left_as_it_is(path: Path) -> None:
    path.parent.mkdir()
    other = sqlite3.connect(path)
    other.execute("CREATE TABLE bookmarks (url)")
    other.close()
    before = path.read_bytes()
    with pytest.raises(InputError, match="another program \\(tables bookmarks\\)") as refusal:
        open_database(path)
    assert refusal.value.code == "database-foreign"
    assert path.read_bytes() == before


def test_what_is_no_regular_file_is_named_and_does_not_block_the_start(path: Path) -> None:
    path.parent.mkdir()
    os.mkfifo(path)
    with pytest.raises(DeviceError, match="not a regular file"):
        open_database(path)
    path.unlink()
    path.symlink_to(path)
    with pytest.raises(DeviceError, match="cannot be used"):
        open_database(path)


FULL, READ_ONLY = StorageTrouble("storage-full", "full"), StorageTrouble("storage-read-only", "read-only")


def events(connections: list[sqlite3.Connection] | None) -> list[list[int]]:
    assert connections is not None
    found = [[row["number"] for row in c.execute("SELECT number FROM events")] for c in connections]
    for connection in connections:
        connection.close()
    return found


def filled(path: Path) -> Database:
    database = Database(path)
    database.write(lambda c: c.execute("INSERT INTO events VALUES (7, '{}')")).result(20)
    return database


@pytest.mark.parametrize("trouble", [FULL, READ_ONLY])
def test_a_database_is_read_and_nothing_is_written_beside_it(path: Path, trouble: StorageTrouble) -> None:
    filled(path).close()
    before = {p.name: p.read_bytes() for p in path.parent.iterdir()}
    found = stand_in(path, trouble, 2)
    assert found is not None
    assert not is_empty(found[0])
    assert events(found) == [[7], [7]]
    assert {p.name: p.read_bytes() for p in path.parent.iterdir()} == before


def test_what_a_killed_station_left_in_the_log_is_read(path: Path) -> None:
    living = filled(path)
    assert events(stand_in(path, FULL, 1)) == [[7]]
    living.close()


def test_a_full_disk_without_a_database_has_an_empty_history(path: Path) -> None:
    path.parent.mkdir()
    found = stand_in(path, FULL, 2)
    assert found is not None
    assert is_empty(found[0])
    assert events(found) == [[], []]


def test_a_directory_that_may_not_be_mounted_yet_is_waited_for(path: Path) -> None:
    assert stand_in(path, FULL, 1) is None
    path.parent.mkdir()
    assert stand_in(path, READ_ONLY, 1) is None


def test_a_damaged_or_older_database_is_waited_for(path: Path) -> None:
    database = filled(path)
    database.write(lambda c: c.execute("PRAGMA user_version = 1").fetchall()).result(20)
    database.close()
    assert stand_in(path, FULL, 1) is None
    path.write_bytes(b"SQLite format 3\0" * 300)
    assert stand_in(path, FULL, 1) is None
    assert stand_in(path, StorageTrouble("database-newer", "newer"), 1) is None
