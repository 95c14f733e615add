"""A directory and a system of fsspec behave alike."""

from __future__ import annotations

import uuid
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from vaoi_station.errors import DeviceError, NotFoundError
from vaoi_station.files.durability import make_directories
from vaoi_station.plant.archive.object_storage import FsspecStorage
from vaoi_station.plant.archive.storage import LocalStorage, Storage


@pytest.fixture(params=["directory", "memory"])
def storage(request: pytest.FixtureRequest, tmp_path: Path) -> Storage:
    """Return an empty storage."""
    return LocalStorage(tmp_path) if request.param == "directory" else FsspecStorage(f"memory://{uuid.uuid4()}")


def test_objects_are_written_listed_read_and_deleted(storage: Storage) -> None:
    storage.write("runs/one/a.json", b"a")
    storage.write("runs/one/a.json", b"ab")
    storage.write("runs/two/b.json", b"b")
    assert storage.read("runs/one/a.json") == b"ab"
    assert storage.names("runs") == ["one", "two"]
    assert [(entry.key, entry.size) for entry in storage.entries("runs")] == [
        ("runs/one/a.json", 2),
        ("runs/two/b.json", 1),
    ]
    entry = storage.entry("runs/one/a.json")
    assert entry is not None
    assert abs(entry.changed - datetime.now(UTC)) < timedelta(hours=1)
    storage.delete("runs/one/a.json")
    storage.delete("runs/one/a.json")
    assert storage.entry("runs/one/a.json") is None
    assert [entry.key for entry in storage.entries("runs")] == ["runs/two/b.json"]


def test_what_is_absent_is_said(storage: Storage) -> None:
    assert storage.names("runs") == []
    assert list(storage.entries("runs")) == []
    assert storage.entry("runs/a") is None
    with pytest.raises(NotFoundError, match="runs/a"):
        storage.read("runs/a")


def test_unfinished_files_are_no_objects_and_files_of_other_programs_are_no_leftovers(tmp_path: Path) -> None:
    storage = LocalStorage(tmp_path)
    assert list(storage.leftovers()) == []
    left = [".archive.json.k3_x9qza", f"blobs/ab/.{'ab' * 32}.abcdefgh", "runs/one/2026-03-01/.r.json.zzzzzzzz"]
    for name in (*left, ".nfs000000000000001b", "runs/.DS_Store", ".snapshot/runs/.a.json.abcdefgh"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"half")
    assert storage.names("") == ["blobs", "runs"]
    assert list(storage.entries("")) == []
    assert [(entry.key, entry.size) for entry in storage.leftovers()] == [(name, 4) for name in left]


def test_a_directory_that_cannot_be_read_is_a_fault_of_the_disk(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    with pytest.raises(DeviceError, match="runs: cannot be read"):
        LocalStorage(tmp_path).read("runs")


def test_a_disk_that_refuses_a_directory_is_no_fault_of_the_run(tmp_path: Path) -> None:
    (tmp_path / "blobs").touch()
    with pytest.raises(DeviceError, match="blobs/ab/x: cannot be written") as caught:
        LocalStorage(tmp_path).write("blobs/ab/x", b"x")
    assert caught.value.code == "archive-absent"


def test_a_directory_that_is_deleted_before_the_file_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[Path] = []

    def make_and_lose(directory: Path) -> None:
        make_directories(directory)
        calls.append(directory)
        if len(calls) == 1:
            directory.rmdir()

    monkeypatch.setattr("vaoi_station.files.documents.make_directories", make_and_lose)
    storage = LocalStorage(tmp_path)
    storage.write("blobs/ab/x", b"x")
    assert storage.read("blobs/ab/x") == b"x"


def test_nothing_is_written_below_a_mount_point_that_lost_its_share(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    storage = LocalStorage(tmp_path / "share")
    storage.write("archive.json", b"x")
    monkeypatch.setattr("vaoi_station.plant.archive.storage._file_system_of", lambda _: -1)
    with pytest.raises(DeviceError, match="of another file system"):
        storage.write("blobs/ab/x", b"x")
    assert [path.name for path in (tmp_path / "share").iterdir()] == ["archive.json"]


def test_a_directory_that_went_is_not_made_again(tmp_path: Path) -> None:
    (tmp_path / "share").mkdir()
    storage = LocalStorage(tmp_path / "share")
    (tmp_path / "share").rmdir()
    with pytest.raises(DeviceError, match="is absent"):
        storage.write("blobs/ab/x", b"x")
    assert not (tmp_path / "share").exists()
