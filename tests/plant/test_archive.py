"""An archive: recordings are added, listed and extracted."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from vaoi_station.errors import DeviceError, InputError, NotFoundError
from vaoi_station.files import open_recording
from vaoi_station.plant import addition
from vaoi_station.plant.archive import Archive, RunLabel
from vaoi_station.plant.manifest import ArchivedRun, ArchiveFault, RunSelection
from vaoi_station.plant.storage import LocalStorage
from vaoi_station.runs.handover.adder import PacedStorage


@pytest.fixture
def archive(tmp_path: Path, recording: Path) -> Archive:
    """Return an archive with two runs of two stations."""
    made = Archive.create(tmp_path / "archive")
    for run, station in (("a", "one"), ("b", "line 2/top")):
        made.add(recording, station=station, label=RunLabel(run=run, time="2026-03-01T08:00:00Z"))
    return made


def test_an_archive_is_not_made_among_other_files(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").touch()
    with pytest.raises(InputError, match="is not empty"):
        Archive.create(tmp_path)


def test_runs_are_listed_by_station_and_found_by_id(archive: Archive) -> None:
    assert [(run.station, run.run) for run in archive.runs()] == [("line 2/top", "b"), ("one", "a")]
    assert archive.run("b").station == "line 2/top"
    with pytest.raises(NotFoundError, match="has no run 'c'"):
        archive.run("c")


def test_runs_are_restored_to_folders_and_the_damaged_one_is_named(archive: Archive, tmp_path: Path) -> None:
    archive.storage.write("runs/one/2026-03-01/a.json", b"{")
    faults: list[ArchiveFault] = []
    assert [run.run for run in archive.restore(tmp_path / "back", on_fault=faults.append)] == ["b"]
    assert (tmp_path / "back" / "b" / "recording.json").is_file()
    assert "a.json" in faults[0].what
    assert [run.run for run in archive.restore(tmp_path / "back")] == ["b"]


def test_the_same_run_again_changes_nothing(tmp_path: Path, recording: Path) -> None:
    archive = Archive.create(tmp_path / "archive")
    first = archive.add(recording)
    before = list(archive.storage.entries(""))
    assert archive.add(recording) == first
    assert list(archive.storage.entries("")) == before


def recorded(recording: Path, kept: Path, verdict: str, identity: dict[str, str] | None, armed: str | None) -> Path:
    """Copy a recording with the record of a station."""
    shutil.copytree(recording, kept, dirs_exist_ok=True)
    record = {"id": "01m7z3abcd-123456", "started": "2026-03-01T08:00:00.125Z", "board_id": armed, "verdict": verdict}
    (kept / "run.json").write_text(json.dumps(record | ({} if identity is None else {"identity": identity})))
    return kept


def test_a_later_record_lowers_the_verdict_of_an_archived_run_and_never_raises_it(
    tmp_path: Path, recording: Path
) -> None:
    archive, kept = Archive.create(tmp_path / "archive"), tmp_path / "kept"
    archive.add(recorded(recording, kept, "ok", None, None))
    assert (
        archive.add(recorded(recording, kept, "ok", {"state": "not-compared", "board_id": "S7"}, None)).serial == "S7"
    )
    added = archive.add(recorded(recording, kept, "degraded", {"state": "differs", "board_id": "S9"}, None))
    assert (added.verdict, added.serial, list(archive.runs())) == ("degraded", "S9", [added])
    assert '"differs"' in (archive.extract(added, tmp_path / "back") / "run.json").read_text()
    # The next machine has corrected its id, or the record is an older copy.
    assert archive.add(recorded(recording, kept, "ok", {"state": "agrees", "board_id": "S9"}, None)) == added
    for verdict in ("ok", "degraded"):
        recorded(recording, kept, verdict, {"state": "agrees", "board_id": "S7"}, None)
        with pytest.raises(InputError, match="has another run under the id"):
            archive.add(kept)
    assert (list(archive.runs()), archive.verify().faults) == ([added], 0)


def test_another_run_under_the_same_id_is_refused(tmp_path: Path, recording: Path) -> None:
    archive = Archive.create(tmp_path / "archive")
    archive.add(recording, label=RunLabel(run="a", time="2026-03-01T08:00:00Z"))
    with pytest.raises(InputError, match="has another run under the id a"):
        archive.add(recording, label=RunLabel(run="a", time="2026-03-01T09:00:00Z"))


def test_a_recording_without_a_calibration_is_refused(tmp_path: Path, recording: Path) -> None:
    bare = tmp_path / "bare"
    shutil.copytree(recording, bare)
    (bare / "calibration.json").unlink()
    archive = Archive.create(tmp_path / "archive")
    with pytest.raises(NotFoundError, match="Give its calibration"):
        archive.add(bare)
    assert list(archive.storage.entries("blobs")) == []
    archive.add(bare, calibration=recording / "calibration.json")


@pytest.mark.parametrize("again", [RunLabel("one"), RunLabel("two")])
def test_damaged_blobs_are_replaced_when_the_run_or_another_that_has_them_is_added(
    tmp_path: Path, recording: Path, again: RunLabel
) -> None:
    archive = Archive.create(tmp_path / "archive")
    first = archive.add(recording, label=RunLabel("one"))
    for blob in first.blobs:
        damaged = bytearray(archive.storage.read(blob.key))
        damaged[5] ^= 1
        archive.storage.write(blob.key, bytes(damaged))
    assert archive.verify().faults == len(set(first.blobs))
    assert list(archive.add(recording, label=again).blobs) == list(first.blobs)
    assert archive.verify().damaged_runs == 0


def test_a_damaged_manifest_comes_back_from_the_recording(tmp_path: Path, recording: Path) -> None:
    archive = Archive.create(tmp_path / "archive")
    first = archive.add(recording)
    archive.storage.write(first.key, b"{")
    assert archive.add(recording) == first
    assert list(archive.runs()) == [first]


def placed(recording: Path, data: Path, run: str) -> Path:
    """Copy a recording into the data of a station that placed it against the reference `taught`."""
    folder = Path(shutil.copytree(recording, data / "recordings" / run))
    made = {"method": "auto", "reference": "taught"}
    record = {"id": run, "started": "2026-03-01T08:00:00.125Z", "verdict": "ok", "made_with": made}
    (folder / "run.json").write_text(json.dumps(record))
    head = json.loads((folder / "recording.json").read_text())
    (folder / "recording.json").write_text(json.dumps(head | {"x_run": run}))
    return folder


def test_the_reference_of_a_run_is_stored_once_and_comes_back(tmp_path: Path, recording: Path) -> None:
    runs = [placed(recording, tmp_path / "data", name) for name in ("a", "b")]
    taught = Path(shutil.copytree(recording, tmp_path / "data" / "references" / "taught"))
    archive = Archive.create(tmp_path / "archive")
    a = archive.add(runs[0])
    before = len(list(archive.storage.entries("blobs")))
    b = archive.add(runs[1])
    assert a.reference == b.reference is not None
    assert len(list(archive.storage.entries("blobs"))) == before + 2, "its head and record"
    restored = archive.extract("b", tmp_path / "restored" / "b")
    assert sorted(path.name for path in (restored / "reference" / "frames").iterdir()) == [
        "c00_r000.tiff", "c00_r001.tiff", "c01_r000.tiff",
    ]  # fmt: skip
    assert (restored / "reference" / "board.json").read_bytes() == (taught / "board.json").read_bytes()
    assert Archive.create(tmp_path / "second").add(restored).reference == b.reference, "it is added from there again"
    assert archive.prune(grace_s=0.0, dry=True).blobs == 0


def test_a_reference_that_was_archived_stays(tmp_path: Path, recording: Path) -> None:
    run = placed(recording, tmp_path / "data", "a")
    archive = Archive.create(tmp_path / "archive")
    assert archive.add(run).reference is None, "it is gone"
    taught = Path(shutil.copytree(recording, tmp_path / "data" / "references" / "taught"))
    added = archive.add(run)
    assert added.reference is not None
    assert archive.run("a") == added
    shutil.rmtree(taught)
    assert archive.add(run) == added
    record = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps(record | {"verdict": "degraded"}))
    lowered = archive.add(run)
    assert (lowered.verdict, lowered.reference) == ("degraded", added.reference)


def test_an_addition_whose_manifest_waits_too_long_is_given_up(
    tmp_path: Path, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = Archive.create(tmp_path / "archive")
    kept = archive.add(recording, label=RunLabel(run="before"))
    now_s, writes = [0.0], list[int]()

    def pace(size: int) -> None:
        writes.extend([size] if size else [])
        # The draft is written first, then the manifest: the archive has the blobs.
        now_s[0] = 7 * 3600.0 if len(writes) > 1 else 0.0

    monkeypatch.setattr(addition, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    with pytest.raises(DeviceError, match="run after took 25200 s, more than 21600 s"):
        Archive(PacedStorage(archive.storage, pace)).add(recording, label=RunLabel(run="after"))
    assert len(writes) == 2
    assert list(archive.runs()) == [kept]


def test_selected_runs_that_are_half_written_are_reported(tmp_path: Path) -> None:
    storage = LocalStorage(tmp_path)
    run = ArchivedRun(
        run="r", station="s", time="2026-03-01T08:00:00Z", board_type="t", pixels=8, documents={}, frames=()
    )
    storage.write(run.draft_key, run.text().encode())
    faults: list[ArchiveFault] = []
    assert not list(Archive(storage).runs(RunSelection(), faults.append))
    assert not faults, "its addition may be under way"
    os.utime(tmp_path / run.draft_key, (0, 0))
    assert not list(Archive(storage).runs(RunSelection(board_type="other"), faults.append))
    assert not faults, "it is of another board type"
    assert not list(Archive(storage).runs(RunSelection(), faults.append))
    assert "run s/r is half written: its addition began at 1970-01-01" in faults[0].what


def test_a_run_comes_back_as_it_was(tmp_path: Path, recording: Path) -> None:
    archive = Archive.create(tmp_path / "archive")
    run = archive.add(recording)
    back = archive.extract(run.run, tmp_path / "back")
    for name in ("recording.json", "calibration.json", "board.json"):
        assert (back / name).read_bytes() == (recording / name).read_bytes()
    there, here = open_recording(recording), open_recording(back)
    for at in ((0, 0), (0, 1), (1, 0)):
        assert np.array_equal(there.frame(*at), here.frame(*at))  # type: ignore[arg-type]


def test_a_flipped_bit_is_named_and_nothing_is_written(tmp_path: Path, recording: Path) -> None:
    archive = Archive.create(tmp_path / "archive")
    run = archive.add(recording)
    content = bytearray(archive.storage.read(run.frames[1].key))
    content[len(content) // 2] ^= 4
    archive.storage.write(run.frames[1].key, bytes(content))
    with pytest.raises(InputError, match=rf"run {run.run}: blob {run.frames[1].sha256} is damaged"):
        archive.extract(run, tmp_path / "back")
    assert not (tmp_path / "back").exists()
