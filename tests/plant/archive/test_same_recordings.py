"""Runs are one recording if frames and head are equal, and only then."""

from __future__ import annotations

from pathlib import Path

from tests.plant.conftest import filmed_again
from vaoi_station.plant.archive import Archive, RunLabel
from vaoi_station.plant.archive.same_recordings import SameRecordings, recording_of


def test_equal_frames_and_heads_are_one_recording(recording: Path, tmp_path: Path) -> None:
    archives = [Archive.create(tmp_path / name) for name in "ab"]
    first, copy = (
        archive.add(recording, label=RunLabel(run=run, time="2026-03-01T08:00:00Z"))
        for archive, run in zip(archives, ("r1", "r2"), strict=True)
    )
    with filmed_again(recording, "r3") as folder:
        replayed = archives[0].add(folder, label=RunLabel(run="r3", time="2026-03-01T08:00:00Z"))
    assert first.frames == replayed.frames
    known = SameRecordings()
    assert known.earlier("a/first", recording_of(first)) is None
    assert known.earlier("a/replayed", recording_of(replayed)) is None
    assert known.earlier("b/copy", recording_of(copy)) == "a/first"


def test_nothing_is_concluded_from_no_frames_or_no_head(recording: Path, tmp_path: Path) -> None:
    run = Archive.create(tmp_path / "archive").add(recording)
    for bare in (run.model_copy(update={"frames": ()}), run.model_copy(update={"documents": {}})):
        assert recording_of(bare) == ""
    known = SameRecordings()
    assert [known.earlier(address, "") for address in ("r1", "r2")] == [None, None]
