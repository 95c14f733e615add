"""Check the data directory, and full file systems that are mounted for the test."""

from __future__ import annotations

import json
import os
import sqlite3
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests.doctor.conftest import assert_problem, only, with_config, without_privileges
from tests.needs import lacking
from vaoi_station.config import KeepConfig
from vaoi_station.doctor import storage_checks
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.running_station import CheckContext
from vaoi_station.store import Database
from vaoi_station.store.database_file import mark_acknowledged

ROOT = Path(__file__).resolve().parents[2]


def test_data_directory_without_write_permission_is_a_fault(context: CheckContext) -> None:
    locked = context.config.data.parent / "locked"
    locked.mkdir(mode=0o500)
    config = context.config.model_copy(update={"data": locked / "data"})
    with without_privileges():
        finding = only(storage_checks.data(with_config(context, config)))
    assert_problem(finding, Level.FAULT, "locked/data cannot be written to by this user")


def space(free_bytes: float, *, inodes: int = 1000, free_inodes: int = 1000) -> Any:
    """Return the figures of a file system as os.statvfs gives them."""
    return cast(
        "os.statvfs_result",
        SimpleNamespace(f_bavail=free_bytes / 4096, f_frsize=4096, f_files=inodes, f_favail=free_inodes),
    )


def test_a_disk_that_cannot_hold_the_quotas_is_a_warning_with_the_numbers() -> None:
    keep = KeepConfig(database_gb=15.0, recordings_gb=20.0, mosaics_gb=1.0)
    short = storage_checks.judge_quotas(space(12e9), int(3e9), keep, "/data")
    assert_problem(
        short,
        Level.WARNING,
        "12 GB free and 3 GB in use",
        "23 GB less",
        "15 GB for the database, 1 GB for pictures of boards, 20 GB for recordings and 2 GB as a reserve",
    )
    assert short.figures == {"free_bytes": 12e9, "used_bytes": 3e9, "quota_bytes": 38e9}
    # What the station has written already counts as space for it.
    assert storage_checks.judge_quotas(space(12e9), int(26e9), keep, "/data").level is Level.OK
    without = KeepConfig(database_gb=15.0, recordings_gb=0.0)
    assert storage_checks.judge_quotas(space(16.1e9), 0, without, "/data").level is Level.OK
    assert "recordings and" not in storage_checks.judge_quotas(space(15e9), 0, without, "/data").message


def mount_prefix() -> list[str]:
    """Return the command prefix that allows mounting; report why the kernel does not permit it."""
    for way in (["unshare", "-m"], ["unshare", "-rm"]):
        if subprocess.run([*way, "true"], capture_output=True, check=False).returncode == 0:
            return way
    return lacking("no mount name space may be made here (CAP_SYS_ADMIN, or user name spaces)")


DOCTOR_ON_A_SMALL_DISK = """
mount -t tmpfs -o size={size} tmpfs "$1/{directory}" && cd "$1" && exec "$2" -m vaoi_station doctor --json
"""


@pytest.mark.parametrize(
    ("directory", "size", "check", "level", "words"),
    [
        ("data", "1M", "disk", "fault", "200 MB are needed"),
        ("data", "1G", "disk", "warning", "kept recordings need more"),
        ("shm", "4M", "shared memory", "fault", "the ring needs 18.4 MB (3 runs × 2 cameras × 10 rows × 307 kB)"),
    ],
)
def test_full_file_systems_are_reported(
    station_toml: Path, directory: str, size: str, check: str, level: str, words: str
) -> None:
    """The small file system is mounted in a name space of its own."""
    (station_toml.parent / directory).mkdir(exist_ok=True)
    script = DOCTOR_ON_A_SMALL_DISK.format(directory=directory, size=size)
    command = [*mount_prefix(), "sh", "-c", script, "sh", str(station_toml.parent), sys.executable]
    done = subprocess.run(
        command, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    found = [f for f in json.loads(done.stdout)["findings"] if f["check"] == check]
    assert [f["level"] for f in found] == [level]
    assert words in found[0]["message"]
    assert found[0]["action"]


def test_what_is_in_the_place_of_the_database_is_judged_and_left_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "station.db"
    assert list(storage_checks.database(path)) == []
    Database(path).close()
    assert list(storage_checks.database(path)) == []
    before = sorted(p.name for p in tmp_path.iterdir())
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA user_version = 999")
    connection.close()
    assert_problem(only(storage_checks.database(path)), Level.FAULT, "has version 999 of the tables")
    path.write_bytes(b"garbage " * 1000)
    assert_problem(only(storage_checks.database(path)), Level.FAULT, "is not a sound database")
    path.unlink()
    assert_problem(only(storage_checks.database(path)), Level.WARNING, "there was a database, and it is gone")
    os.mkfifo(path)
    assert_problem(only(storage_checks.database(path)), Level.FAULT, "is not a regular file")
    path.unlink()
    other = sqlite3.connect(path)
    other.execute("CREATE TABLE bookmarks (url)")
    other.close()
    assert_problem(only(storage_checks.database(path)), Level.FAULT, "is a database of another program")
    assert sorted(p.name for p in tmp_path.iterdir()) == before


def test_a_database_that_was_set_aside_stays_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "station.db"
    path.write_bytes(b"garbage " * 1000)
    Database(path).close()
    assert_problem(only(storage_checks.database(path)), Level.WARNING, "was set aside because it was damaged")
    (kept,) = tmp_path.glob("station.db.damaged-*")
    mark_acknowledged(kept)
    assert list(storage_checks.database(path)) == []
