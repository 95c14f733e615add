"""Pruning removes what is asked for and what no run needs, and nothing else."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.plant.conftest import filmed_again
from vaoi_station.plant import catalogue
from vaoi_station.plant.archive import Archive, RunLabel, RunSelection
from vaoi_station.plant.manifest import ArchiveFault
from vaoi_station.plant.storage import Storage

AT_ONCE_S = -60.0
_KILLED = """
import os, signal, sys
from pathlib import Path
from vaoi_station.plant.storage import LocalStorage
os.fchmod = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
LocalStorage(Path(sys.argv[1])).write("blobs/22/" + "2" * 64, b"half")
"""
"""A program that is killed while it writes a blob."""


@pytest.fixture
def archive(tmp_path: Path, recording: Path) -> Archive:
    """Return an archive with two runs of the same frames, and a blob that no run needs."""
    made = Archive.create(tmp_path / "archive")
    for run, day in (("a", "01"), ("b", "02")):
        with filmed_again(recording, run) as folder:
            made.add(folder, station="one", label=RunLabel(run=run, time=f"2026-03-{day}T08:00:00Z"))
    made.storage.write("blobs/00/" + "0" * 64, b"left over")
    return made


def blobs_of(archive: Archive) -> int:
    """Return the number of stored blobs."""
    return len(list(archive.storage.entries("blobs")))


def test_young_blobs_stay(archive: Archive) -> None:
    before = blobs_of(archive)
    assert archive.prune().blobs == 0
    assert blobs_of(archive) == before


def test_blobs_that_another_run_needs_stay(archive: Archive) -> None:
    before, head = blobs_of(archive), archive.run("a").documents["head"].bytes
    pruned = archive.prune(RunSelection(until="2026-03-01"), grace_s=AT_ONCE_S)
    assert (pruned.runs, pruned.blobs, pruned.bytes, pruned.faults) == (1, 2, 9 + head, 0)
    assert blobs_of(archive) == before - 2
    assert [run.run for run in archive.runs()] == ["b"]
    assert archive.verify().faults == 0


def test_a_dry_call_removes_nothing(archive: Archive) -> None:
    before = [entry.key for entry in archive.storage.entries("")]
    assert archive.prune(RunSelection(), grace_s=AT_ONCE_S, dry=True).runs == 2
    assert [entry.key for entry in archive.storage.entries("")] == before


def test_all_runs_and_their_blobs_go_and_what_killed_writers_left(archive: Archive) -> None:
    killed = subprocess.run([sys.executable, "-c", _KILLED, archive.url], check=False)
    assert killed.returncode == -signal.SIGKILL
    faults: list[ArchiveFault] = []
    archive.verify(on_fault=faults.append, under_way_s=AT_ONCE_S)
    assert "/blobs/22/.2222" in faults[0].what
    assert "was left by a program that was killed while it wrote" in faults[0].what
    assert (archive.verify().faults, archive.prune().leftovers) == (0, 0), "it may be under way"
    assert archive.prune(RunSelection(), grace_s=AT_ONCE_S).leftovers == 1
    assert [path.name for path in Path(archive.url).rglob("*") if path.is_file()] == ["archive.json"]


def test_no_blob_goes_while_a_manifest_cannot_be_read(archive: Archive) -> None:
    archive.storage.write("runs/one/2026-03-01/a.json", b"{")
    before, faults = blobs_of(archive), list[ArchiveFault]()
    assert archive.prune(grace_s=AT_ONCE_S, on_fault=faults.append).faults == 2
    assert "a.json" in faults[0].what
    assert "no blob was removed" in faults[1].what
    assert blobs_of(archive) == before
    assert archive.prune(ids=frozenset({"a"}), grace_s=AT_ONCE_S).runs == 1
    assert archive.verify().faults == 0


def test_a_blob_that_is_written_while_manifests_are_read_stays(
    archive: Archive, monkeypatch: pytest.MonkeyPatch
) -> None:
    late = "blobs/11/" + "1" * 64
    listed = catalogue.places

    def write_late(storage: Storage) -> Iterator[catalogue.Place]:
        storage.write(late, b"of a run that is being added")
        yield from listed(storage)

    monkeypatch.setattr(catalogue, "places", write_late)
    archive.prune(grace_s=0.0)
    assert archive.storage.entry(late) is not None


def test_one_of_two_runs_with_one_id_is_removed_by_its_station(archive: Archive, recording: Path) -> None:
    archive.add(recording, station="two", label=RunLabel(run="a"))
    assert archive.prune(RunSelection(station="two"), ids=frozenset({"a"})).runs == 1
    assert [(run.station, run.run) for run in archive.runs()] == [("one", "a"), ("one", "b")]


@pytest.mark.parametrize("place", ["blobs", "blobs/blobs", "runs/blobs/a"])
def test_an_archive_may_have_the_name_of_one_of_its_folders(recording: Path, place: str) -> None:
    made = Archive.create(f"memory://{place}")
    made.add(recording, label=RunLabel(run="a"))
    made.storage.write("blobs/00/" + "0" * 64, b"left over")
    before = blobs_of(made)
    assert made.prune(grace_s=AT_ONCE_S).blobs == 1
    assert blobs_of(made) == before - 1
    made.prune(RunSelection(), grace_s=AT_ONCE_S)
    assert [entry.key for entry in made.storage.entries("")] == ["archive.json"]
    made.storage.delete("archive.json")
