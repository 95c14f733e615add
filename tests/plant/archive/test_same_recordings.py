"""Runs are one recording if frames and head are equal, and only then."""

from __future__ import annotations

from pathlib import Path

from tests.plant.conftest import filmed_again
from vaoi_station.plant.archive import Archive, RunLabel
from vaoi_station.plant.archive.same_recordings import SameRecordings, frames_of


def test_equal_frames_and_heads_are_one_recording(recording: Path, tmp_path: Path) -> None:
    archives = [Archive.create(tmp_path / name) for name in "ab"]
    first, copy = (
        archive.add(recording, label=RunLabel(run=run, time="2026-03-01T08:00:00Z"))
        for archive, run in zip(archives, ("r1", "r2"), strict=True)
    )
    with filmed_again(recording, "r3") as folder:
        replayed = archives[0].add(folder, label=RunLabel(run="r3", time="2026-03-01T08:00:00Z"))
    assert frames_of(first) == frames_of(copy) == frames_of(replayed)
    known = SameRecordings()
    assert known.earlier(archives[0].storage, first.key, frames_of(first)) is None
    assert known.earlier(archives[0].storage, replayed.key, frames_of(replayed)) is None
    found = known.earlier(archives[1].storage, copy.key, frames_of(copy))
    assert found == f"{archives[0].url}/{first.key}"


def test_nothing_is_concluded_from_a_head_that_cannot_be_read_or_from_no_frames(
    recording: Path, tmp_path: Path
) -> None:
    archive = Archive.create(tmp_path / "archive")
    runs = [archive.add(recording, label=RunLabel(run=run)) for run in ("r1", "r2")]
    archive.storage.delete(runs[0].documents["head"].key)
    known = SameRecordings()
    assert [known.earlier(archive.storage, run.key, frames_of(run)) for run in runs] == [None, None]
    assert frames_of(runs[0].model_copy(update={"frames": ()})) == ""
    assert [known.earlier(archive.storage, run.key, "") for run in runs] == [None, None]
