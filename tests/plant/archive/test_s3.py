"""An archive in a bucket of an S3-compatible server, which runs on loopback."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.request import Request, urlopen

import numpy as np
import pytest

from tests.plant.conftest import filmed_again
from vaoi_station.errors import DeviceError, InputError
from vaoi_station.files import open_recording
from vaoi_station.plant.archive import Archive, RunLabel

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


def test_runs_are_pruned(bucket: str, recording: Path) -> None:
    archive = Archive.create(bucket)
    archive.add(recording, label=RunLabel(run="a"))
    assert archive.prune(ids=frozenset({"a"}), grace_s=-60.0).blobs == 6
    assert [entry.key for entry in archive.storage.entries("")] == ["archive.json"]


def test_an_absent_bucket_is_no_archive(bucket: str) -> None:
    with pytest.raises(InputError, match="is no archive"):
        Archive.open("s3://not-there/archive")


def test_a_server_that_does_not_answer_is_named(bucket: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    with pytest.raises(DeviceError, match=r"archive\.json: cannot be read"):
        Archive.open(bucket)
