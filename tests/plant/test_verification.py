"""What is missing, damaged or left over is named, and the rest is verified."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.plant.conftest import filmed_again
from vaoi_station.plant import addition
from vaoi_station.plant.archive import Archive, RunLabel, RunSelection
from vaoi_station.plant.manifest import ArchiveFault, ignore_fault


@pytest.fixture
def archive(tmp_path: Path, recording: Path) -> Archive:
    """Return an archive with two runs, which share every blob but that of their heads."""
    made = Archive.create(tmp_path / "archive")
    for run in ("a", "b"):
        with filmed_again(recording, run) as folder:
            made.add(folder, label=RunLabel(run=run, time="2026-03-01T08:00:00Z"))
    return made


def test_a_sound_archive_has_no_faults(archive: Archive) -> None:
    found = archive.verify()
    assert (found.runs, found.damaged_runs, found.faults) == (2, 0, 0)
    assert found.blobs == 2 + 2 * (1 + 3)
    assert archive.verify(RunSelection(until="2026-02-28")).runs == 0


def test_one_recording_under_several_ids_days_or_stations_is_named(archive: Archive, recording: Path) -> None:
    with filmed_again(recording, "a") as folder:
        archive.add(folder, station="one", label=RunLabel(run="c", time="2026-03-02T08:00:00Z"))
        archive.add(folder, station="one", label=RunLabel(run="b", time="2026-03-02T08:00:00Z"))
    faults: list[ArchiveFault] = []
    found = archive.verify(on_fault=faults.append)
    assert (found.runs, found.damaged_runs) == (2, 0)
    assert "2 runs have the id b" in faults[0].what
    assert f"runs/unnamed/2026-03-01/a.json: is the same recording as {archive.url}/runs/one/2026-03-02/c.json" in (
        faults[1].what
    )


def test_missing_and_damaged_blobs_are_named_for_every_run(archive: Archive) -> None:
    run = archive.run("a")
    flipped = bytearray(archive.storage.read(run.frames[0].key))
    flipped[40] ^= 1
    archive.storage.write(run.frames[0].key, bytes(flipped))
    archive.storage.delete(run.frames[1].key)
    faults: list[ArchiveFault] = []
    found = archive.verify(on_fault=faults.append)
    assert (found.runs, found.damaged_runs, found.faults) == (2, 2, 4)
    assert f"run a: blob {run.frames[0].sha256} is damaged" in faults[0].what
    assert f"run a: blob {run.frames[1].sha256} is missing" in faults[1].what
    assert "run b" in faults[2].what


def test_a_run_half_written_is_named_once_it_is_not_under_way(
    archive: Archive, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("power cut")

    monkeypatch.setattr(addition, "_store_manifest", fail)
    with pytest.raises(RuntimeError):
        archive.add(recording, station="one", label=RunLabel(run="c"))
    assert archive.verify().faults == 0
    faults: list[ArchiveFault] = []
    archive.verify(on_fault=faults.append, under_way_s=-60.0)
    assert "run one/c is half written" in faults[0].what
    monkeypatch.undo()
    archive.add(recording, station="one", label=RunLabel(run="c"))
    assert archive.verify(on_fault=ignore_fault, under_way_s=-60.0).faults == 0
