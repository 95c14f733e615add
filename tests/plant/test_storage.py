"""Directories and object stores."""

from __future__ import annotations

import itertools
import sys
import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path
from urllib.request import Request, urlopen

import numpy as np
import pytest

from tests.plant.conftest import filmed_again
from vaoi_station.errors import DeviceError, InputError
from vaoi_station.files import open_recording
from vaoi_station.files.directories import make_directories
from vaoi_station.plant.archive import Archive, RunLabel
from vaoi_station.plant.storage import FsspecStorage, LocalStorage, Storage


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
    monkeypatch.setattr("vaoi_station.plant.storage._file_system_of", lambda _: -1)
    with pytest.raises(DeviceError, match="of another file system"):
        storage.write("blobs/ab/x", b"x")
    assert [path.name for path in (tmp_path / "share").iterdir()] == ["archive.json"]


def test_without_the_extra_the_refusal_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(InputError, match=r"Install vaoi-station\[plant\]"):
        FsspecStorage("memory://a")


_NUMBERS = itertools.count()


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    """Return the address of a running server."""
    from moto.server import ThreadedMotoServer

    running = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    running.start()
    host, port = running.get_host_and_port()
    yield f"http://{host}:{port}"
    running.stop()


@pytest.fixture
def bucket(server: str, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the address of a new, empty bucket."""
    for name, value in {
        "AWS_ENDPOINT_URL": server,
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_DEFAULT_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(name, value)
    name = f"plant-{next(_NUMBERS)}"
    urlopen(Request(f"{server}/{name}", method="PUT")).close()
    return f"s3://{name}/archive"


def test_two_stations_write_at_the_same_time(bucket: str, recording: Path, tmp_path: Path) -> None:
    Archive.create(bucket)

    def add(station: str, runs: str) -> None:
        archive = Archive.open(bucket)
        for run in runs:
            with filmed_again(recording, run) as folder:
                archive.add(folder, station=station, label=RunLabel(run, "2026-03-01T08:00:00Z"))

    with ThreadPoolExecutor() as pool:
        list(pool.map(add, ("one", "line 2/top"), ("ab", "cd")))
    archive = Archive.open(bucket)
    assert [run.run for run in archive.runs()] == ["c", "d", "a", "b"]
    found = archive.verify()
    assert (found.runs, found.faults) == (4, 0)
    assert len(list(archive.storage.entries("blobs"))) == 2 + 3 + 4
    back = open_recording(archive.extract("b", tmp_path / "back"))
    assert np.array_equal(back.frame(0, 1), open_recording(recording).frame(0, 1))  # type: ignore[arg-type]
