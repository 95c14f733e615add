"""A file that is deleted or replaced while it is open."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.store.conftest import unreachable
from vaoi_station.store.database_file import open_database
from vaoi_station.store.file_watch import FileWatch


def test_a_deleted_file_is_written_back_with_all_that_was_committed(path: Path) -> None:
    connection, _ = open_database(path)
    connection.execute("INSERT INTO events VALUES (1, '{}')")
    watch = FileWatch(path)
    seen = [watch.changed]
    shutil.rmtree(path.parent)
    seen.append(watch.changed)
    assert seen == [False, True]
    assert watch.rescue(connection, lambda: None).code == "database-deleted"
    connection.close()
    again, notice = open_database(path)
    assert [tuple(row) for row in again.execute("SELECT * FROM events")] == [(1, "{}")]
    assert notice is None
    watch.forget()
    assert not watch.changed
    again.close()


def test_a_large_file_is_written_back_with_a_heartbeat(path: Path) -> None:
    connection, _ = open_database(path)
    connection.executemany("INSERT INTO events VALUES (?, '{}')", ((n,) for n in range(20_000)))
    watch, beats = FileWatch(path), list[int]()
    path.unlink()
    watch.rescue(connection, lambda: beats.append(1))
    connection.close()
    assert len(beats) > 5


def test_a_file_in_its_place_is_left_there(path: Path) -> None:
    connection, _ = open_database(path)
    connection.execute("INSERT INTO events VALUES (1, '{}')")
    watch = FileWatch(path)
    path.unlink()
    path.write_text("what a person put there")
    assert watch.rescue(connection, lambda: None).code == "database-replaced"
    connection.close()
    assert path.read_text() == "what a person put there"
    [kept] = path.parent.glob("*.replaced-*")
    saved, _ = open_database(kept)
    assert len(saved.execute("SELECT * FROM events").fetchall()) == 1
    saved.close()


def test_a_directory_that_cannot_be_searched_proves_no_change(path: Path) -> None:
    """Else the write-ahead log of a file that is still there would be deleted as that of another one."""
    connection, _ = open_database(path)
    connection.execute("INSERT INTO events VALUES (1, '{}')")
    before = sorted(path.parent.iterdir())
    watch = FileWatch(path)
    with unreachable(path.parent):
        assert not watch.changed
        with pytest.raises(PermissionError):
            watch.rescue(connection, lambda: None)
    assert (sorted(path.parent.iterdir()), watch.changed) == (before, False)
    connection.close()


def test_the_space_that_is_left_is_measured(path: Path) -> None:
    path.parent.mkdir()
    watch = FileWatch(path)
    assert watch.free_bytes is not None
    before = watch.free_bytes
    shutil.rmtree(path.parent)
    watch.measure()
    assert watch.free_bytes == before, "the last value is kept while the directory cannot be read"
