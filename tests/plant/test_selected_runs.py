"""The runs of several archives: equal ones once, different ones under one id not at all."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.plant.conftest import add_runs, filmed_again
from vaoi_station.errors import InputError
from vaoi_station.plant.archive import Archive, RunLabel, RunSelection
from vaoi_station.plant.selected_runs import SelectedRuns
from vaoi_station.plant.storage import LocalStorage


def test_runs_are_found_once_and_in_order(recording: Path, tmp_path: Path) -> None:
    first = Archive.create(tmp_path / "a")
    for station, run in (("b", "r1"), ("a", "r2")):
        with filmed_again(recording, run) as folder:
            first.add(folder, station=station, label=RunLabel(run=run, time="2026-11-01T10:00:00Z"))
    second = Archive.open(shutil.copytree(tmp_path / "a", tmp_path / "b"))
    found = list(SelectedRuns([first.url, second.url, first.url], RunSelection(), pytest.fail))
    assert [(url, key.rpartition("/")[2]) for url, key, _ in found] == [(first.url, "r2.json"), (first.url, "r1.json")]


def test_one_recording_in_several_places_counts_once_and_is_named(recording: Path, tmp_path: Path) -> None:
    archives = [Archive.create(tmp_path / name) for name in "abc"]
    for archive, (station, run) in zip(archives, (("x", "r1"), ("w", "r1"), ("y", "r2")), strict=True):
        archive.add(recording, station=station, label=RunLabel(run=run, time="2026-11-01T10:00:00Z"))
    first, same_id, other_id = (archive.url for archive in archives)
    reported: list[str] = []
    (found,) = SelectedRuns([first, other_id], RunSelection(), reported.append)
    assert (found.archive, found.key) == (first, "runs/x/2026-11-01/r1.json")
    assert f"r2.json: is the same recording as {first}/runs/x/2026-11-01/r1.json" in reported[0]
    assert not list(SelectedRuns([first, same_id], RunSelection(), reported.append))
    assert f"two runs have this id, and differ: {first}/runs/x/2026-11-01/r1.json, {same_id}/runs/w" in reported[1]


def test_each_run_of_a_station_that_replays_a_recording_is_read_once(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive, reads, read = Archive.create(tmp_path / "archive"), list[str](), LocalStorage.read
    add_runs(archive, recording, 8)

    def counted(storage: LocalStorage, key: str) -> bytes:
        reads.append(key)
        return read(storage, key)

    monkeypatch.setattr(LocalStorage, "read", counted)
    found = list(SelectedRuns([archive.url], RunSelection(), pytest.fail))
    assert sorted(key for key in reads if key != "archive.json") == sorted(run.key for run in found)
    assert len(found) == 8


def test_an_archive_that_cannot_be_used_is_named_and_the_others_are_used(recording: Path, tmp_path: Path) -> None:
    archives = [Archive.create(tmp_path / name) for name in "ab"]
    for archive, run in zip(archives, ("r1", "r2"), strict=True):
        archive.add(recording, station="s", label=RunLabel(run=run, time="2026-11-01T10:00:00Z"))
    marker = tmp_path / "b" / "archive.json"
    marker.write_text(marker.read_text().replace("1", "9"))
    reported: list[str] = []
    urls = [str(tmp_path / name) for name in ("absent", "a", "b")]
    assert [run.archive for run in SelectedRuns(urls, RunSelection(), reported.append)] == [urls[1]]
    assert f"{urls[0]}: is no archive" in reported[0]
    assert "version is 9" in reported[1]
    with pytest.raises(InputError, match="is no archive"):
        SelectedRuns([urls[0], urls[2]], RunSelection(), reported.append)
