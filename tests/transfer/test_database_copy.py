"""Copies are consistent while another process writes; other files are refused."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from vaoi_station.errors import DeviceError, InputError
from vaoi_station.store import Database
from vaoi_station.transfer.database_copy import check_database, copy_database, reading

WRITER = """
import sqlite3, sys
c = sqlite3.connect(sys.argv[1], isolation_level=None, timeout=30)
c.execute("PRAGMA synchronous = OFF")
for n in range(1, 10**9):
    c.execute("BEGIN IMMEDIATE")
    c.execute("INSERT INTO events VALUES (?, ?)", (2 * n, "x" * 500))
    c.execute("INSERT INTO events VALUES (?, ?)", (2 * n + 1, "x" * 500))
    c.execute("COMMIT")
    if n == 200:
        print("on", flush=True)
"""


def test_a_copy_is_consistent_while_a_station_writes(tmp_path: Path) -> None:
    Database(tmp_path / "station.db").close()
    arguments = [sys.executable, "-c", WRITER, str(tmp_path / "station.db")]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE) as writer:
        try:
            assert writer.stdout is not None
            assert writer.stdout.readline() == b"on\n"
            for number in range(3):
                copy = tmp_path / f"copy{number}.db"
                copy_database(tmp_path / "station.db", copy)
                check_database(copy)
                with closing(sqlite3.connect(copy)) as opened:
                    (rows,) = opened.execute("SELECT count(*) FROM events").fetchone()
                assert rows >= 400
                assert rows % 2 == 0, "the copy has half a transaction"
        finally:
            writer.kill()


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"), reading(tmp_path / "absent"):
        pass
    (tmp_path / "garbage").write_bytes(b"no database " * 1000)
    with pytest.raises(DeviceError, match="cannot be read"), reading(tmp_path / "garbage"):
        pass
    with closing(sqlite3.connect(tmp_path / "other")) as other:
        other.execute("PRAGMA user_version = 99")
    (tmp_path / "other").touch()
    with pytest.raises(InputError, match="version"), reading(tmp_path / "other"):
        pass


def test_a_damaged_copy_is_found(tmp_path: Path) -> None:
    path = tmp_path / "station.db"
    Database(path).close()
    content = bytearray(path.read_bytes())
    content[-4096:] = b"\xa5" * 4096
    path.write_bytes(content)
    with pytest.raises(DeviceError):
        check_database(path)
