"""Archives are opened, list their runs, and name what cannot be used."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.plant.archive import Archive, RunLabel
from vaoi_station.plant.archive.fault import ArchiveFault


@pytest.fixture
def archive(tmp_path: Path, recording: Path) -> Archive:
    """Return an archive with two runs of two stations."""
    made = Archive.create(tmp_path / "archive")
    for run, station in (("a", "one"), ("b", "line 2/top")):
        made.add(recording, station=station, label=RunLabel(run=run, time="2026-03-01T08:00:00Z"))
    return made


def test_a_folder_without_an_archive_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is no archive"):
        Archive.open(tmp_path)


def test_an_archive_is_not_made_among_other_files(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").touch()
    with pytest.raises(InputError, match="is not empty"):
        Archive.create(tmp_path)


def test_a_newer_archive_is_refused(archive: Archive) -> None:
    archive.storage.write("archive.json", b'{"format": "vaoi-archive", "version": 2}')
    with pytest.raises(InputError, match="version is 2"):
        Archive.open(archive.url)


def test_runs_are_listed_by_station_and_found_by_id(archive: Archive) -> None:
    assert [(run.station, run.run) for run in archive.runs()] == [("line 2/top", "b"), ("one", "a")]
    assert archive.run("b").station == "line 2/top"
    with pytest.raises(NotFoundError, match="has no run 'c'"):
        archive.run("c")


def test_two_runs_with_one_id_are_named_and_the_others_listed(archive: Archive, recording: Path) -> None:
    archive.add(recording, station="two", label=RunLabel(run="a", time="2026-03-02T08:00:00Z"))
    faults: list[ArchiveFault] = []
    assert [run.run for run in archive.runs(on_fault=faults.append)] == ["b"]
    assert len(faults) == 1
    assert "2 runs have the id a: runs/one/2026-03-01/a.json" in faults[0].what
    with pytest.raises(InputError, match="2 runs have the id a"):
        archive.run("a")


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (b'{"format"', "not valid JSON"),
        (b'{"format": "vaoi-archived-run", "version": 2}', "version is 2"),
        (b'{"format": "vaoi-archived-run", "version": 1}', "station"),
    ],
)
def test_a_manifest_that_cannot_be_read_is_named(archive: Archive, content: bytes, named: str) -> None:
    archive.storage.write("runs/one/2026-03-01/a.json", content)
    faults: list[ArchiveFault] = []
    assert [run.run for run in archive.runs(on_fault=faults.append)] == ["b"]
    assert "a.json" in str(faults[0])
    assert named in str(faults[0])


def test_a_renamed_manifest_is_named(archive: Archive) -> None:
    document = json.loads(archive.storage.read("runs/one/2026-03-01/a.json"))
    archive.storage.write("runs/one/2026-03-01/c.json", json.dumps(document).encode())
    faults: list[ArchiveFault] = []
    assert [run.run for run in archive.runs(on_fault=faults.append)] == ["b", "a"]
    assert "c.json: is the manifest of runs/one/2026-03-01/a.json" in faults[0].what


def test_runs_are_restored_to_folders_and_the_damaged_one_is_named(archive: Archive, tmp_path: Path) -> None:
    archive.storage.write("runs/one/2026-03-01/a.json", b"{")
    faults: list[ArchiveFault] = []
    assert [run.run for run in archive.restore(tmp_path / "back", on_fault=faults.append)] == ["b"]
    assert (tmp_path / "back" / "b" / "recording.json").is_file()
    assert "a.json" in faults[0].what
    assert [run.run for run in archive.restore(tmp_path / "back")] == ["b"]
