"""Causes of errors of SQLite and of files, from errors that really happen."""

from __future__ import annotations

import errno
import os
import sqlite3
from pathlib import Path
from types import SimpleNamespace

import pytest

from vaoi_station.errors import DeviceError, InputError, InternalError
from vaoi_station.store.storage_trouble import translated, trouble_of

PATH = Path("station.db")


def error_of(statement: str, connection: sqlite3.Connection) -> sqlite3.Error:
    with pytest.raises(sqlite3.Error) as raised:
        connection.execute(statement)
    return raised.value


def test_a_read_only_database_a_missing_folder_and_garbage_are_named(tmp_path: Path) -> None:
    read_only = sqlite3.connect(f"file:{tmp_path / 'b.db'}?mode=rwc", uri=True)
    read_only.execute("CREATE TABLE t (x)")
    read_only.execute("PRAGMA query_only = ON")
    codes = [trouble_of(error_of("INSERT INTO t VALUES (1)", read_only), PATH)]
    read_only.close()
    with pytest.raises(sqlite3.Error) as absent:
        sqlite3.connect(tmp_path / "none" / "c.db")
    codes.append(trouble_of(absent.value, PATH))
    (tmp_path / "d.db").write_bytes(b"garbage " * 500)
    garbage = sqlite3.connect(tmp_path / "d.db")
    codes.append(trouble_of(error_of("SELECT * FROM sqlite_master", garbage), PATH))
    garbage.close()
    assert [t.code for t in codes if t] == ["storage-read-only", "storage-unavailable", "database-damaged"]


@pytest.mark.parametrize(
    ("number", "code"),
    [
        (errno.ENOSPC, "storage-full"),
        (errno.EROFS, "storage-read-only"),
        (errno.EIO, "storage-unavailable"),
    ],
)
def test_errors_of_files_have_the_same_codes(number: int, code: str) -> None:
    trouble = trouble_of(OSError(number, "words of the system"), PATH)
    assert trouble is not None
    assert trouble.code == code
    assert "words of the system" in trouble.message


def test_other_errors_are_no_trouble_of_the_storage() -> None:
    connection = sqlite3.connect(":memory:")
    connection.execute("CREATE TABLE t (x UNIQUE)")
    connection.execute("INSERT INTO t VALUES (1)")
    twice = error_of("INSERT INTO t VALUES (1)", connection)
    wrong = error_of("SELECT nothing FROM nowhere", connection)
    connection.close()
    assert trouble_of(twice, PATH) is trouble_of(wrong, PATH) is trouble_of(ValueError(), PATH) is None
    assert isinstance(translated(twice, PATH), InternalError)
    assert isinstance(translated(wrong, PATH), DeviceError)
    assert trouble_of(InputError("x"), PATH) is None


@pytest.mark.parametrize(
    ("flag", "free", "code"),
    [(1, 9, "storage-read-only"), (0, 0, "storage-full"), (0, 9, "storage-unavailable")],
)
def test_a_vague_error_is_named_by_the_state_of_the_disk(
    monkeypatch: pytest.MonkeyPatch, flag: int, free: int, code: str
) -> None:
    """Real disks in these states: `tests/system/test_storage_troubles.py`."""
    state = SimpleNamespace(f_flag=flag, f_blocks=10, f_bavail=free)
    monkeypatch.setattr(os, "statvfs", lambda _: state)
    error = sqlite3.OperationalError("unable to open database file")
    error.sqlite_errorcode = sqlite3.SQLITE_CANTOPEN
    found = trouble_of(error, Path("data/station.db"))
    assert found is not None
    assert found.code == code
