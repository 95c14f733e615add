"""Frames of failed, degraded and pinned runs are kept on disk; the line never waits for it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from tests.runs.conftest import a_stitch
from vaoi_station.config import KeepConfig
from vaoi_station.errors import DeviceError, GoneError
from vaoi_station.files import open_recording, read_board_type, read_calibration, read_stitch, write_board_type
from vaoi_station.files.directories import remove_directory, size_below
from vaoi_station.files.results import stitch_text
from vaoi_station.model import BoardIdentity, Status, Verdict
from vaoi_station.runs.archive import recordings as module
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive, FinishedRun
from vaoi_station.runs.archive.recordings import Recordings
from vaoi_station.runs.states.schemas import IdentitySummary, Origin, RunDetail

PATIENCE_S = 20.0


def wait_event(rig: Any, run: str, kind: str, code: str = "") -> str:
    """Wait for an event of a run, and return its message."""
    after = 0
    while events := rig.coordinator.events(after, PATIENCE_S):
        for event in events:
            if (event.run, event.kind, event.code) == (run, kind, code):
                return str(event.message)
            after = event.number
    raise AssertionError(f"no event {kind} {code} of {run}")


def a_board(rig: Any, verdict: Status = Status.OK) -> RunDetail:
    rig.workers.result = lambda head: a_stitch(head, verdict, ("weak",) if verdict is not Status.OK else ())
    grant = rig.arm()
    rig.board(grant)
    detail: RunDetail = rig.result_of(grant.run)
    return detail


@pytest.fixture
def rig(make_rig: Callable[..., Any]) -> Any:
    made = make_rig()
    made.ready()
    return made


def test_a_start_compares_the_records_of_recordings_with_the_database(rig: Any, make_rig: Callable[..., Any]) -> None:
    run = a_board(rig, Status.DEGRADED)
    wait_event(rig, run.id, "recording")
    path = rig.coordinator.kept.recordings.path_of(run.id) / "run.json"
    # The station ended after the identity of the board was decided, and before its recording had it.
    pending = run.model_copy(update={"verdict": Status.OK, "identity": IdentitySummary(state="pending")})
    path.write_text(pending.model_dump_json())
    make_rig(name="started-again")
    rig.wait_for(lambda: '"pending"' not in path.read_text(), "the record is brought up to date")
    record = RunDetail.model_validate_json(path.read_text())
    assert (record.verdict, record.identity) == (Status.DEGRADED, None)


def test_a_run_that_the_database_has_no_more_is_offered_with_the_verdict_of_a_board_that_was_not_read(rig: Any) -> None:
    run = a_board(rig, Status.DEGRADED)
    wait_event(rig, run.id, "recording")
    path = rig.coordinator.kept.recordings.path_of(run.id)
    rig.coordinator.kept.recordings.stop()  # It brings the record up to date after the event.
    pending = run.model_copy(update={"verdict": Status.OK, "reasons": (), "identity": IdentitySummary(state="pending")})
    (path / "run.json").write_text(pending.model_dump_json())
    board = read_board_type(path / "board.json")
    write_board_type(path / "board.json", board.model_copy(update={"identity": BoardIdentity(required=True)}))
    rig.store.retention.forget_details([run.id]).result(10)
    events = EventLog(rig.store)
    frames: Any = Away(0)
    keeper = Recordings(path.parent, KeepConfig(), Archive(rig.store, events), events, frames)
    offered = list[str]()
    keeper.on_kept = offered.append
    keeper.offer_all()
    keeper.start()
    rig.wait_for(lambda: offered == [run.id], "the run is offered")
    keeper.stop()
    record = RunDetail.model_validate_json((path / "run.json").read_text())
    assert (record.verdict, [reason.code for reason in record.reasons]) == (Status.DEGRADED, ["identity-not-read"])


def pixels(rig: Any, run: RunDetail, camera: int, row: int) -> Any:
    return rig.coordinator.frame(run.id, camera, row)[0]


def test_the_frames_of_a_degraded_run_are_a_complete_recording(rig: Any) -> None:
    run = a_board(rig, Status.DEGRADED)
    expected = pixels(rig, run, 1, 2)
    wait_event(rig, run.id, "recording")
    kept = rig.coordinator.kept
    path = kept.recordings.path_of(run.id)
    recording = open_recording(path)
    frame = recording.frame(1, 2)
    assert frame is not None
    assert np.array_equal(frame, expected)
    assert recording.head.rows == run.rows
    assert read_board_type(path / "board.json").name == "small"
    assert read_stitch(path / "result.json").status is Status.DEGRADED
    assert len(read_calibration(path / "calibration.json").camera_matrices) == 2
    assert RunDetail.model_validate_json((path / "run.json").read_text()).id == run.id
    shown = kept.shown(rig.coordinator.run(run.id))
    assert (shown.recording, shown.pinned) == (True, False)
    retention = rig.coordinator.snapshot().retention
    assert retention.recordings == 1
    assert retention.recordings_bytes > expected.nbytes


def test_pictures_of_a_run_that_left_the_memory_come_from_its_recording(rig: Any) -> None:
    rig.workers.result = lambda head: a_stitch(head, Status.DEGRADED, ("weak",))
    grant = rig.arm()
    rig.board(grant, verdicts={1: Verdict.INCOMPLETE})
    run = rig.result_of(grant.run)
    expected = pixels(rig, run, 1, 2)
    wait_event(rig, run.id, "recording")
    view = rig.coordinator.images(run.id, "U1").chosen[0].view
    rig.coordinator.release(run.id)
    assert rig.coordinator.run(run.id).frames_available is False
    found, record = rig.coordinator.frame(run.id, 1, 2)
    assert np.array_equal(found, expected)
    assert found.dtype == expected.dtype
    assert (record.camera, record.row) == (1, 2)
    assert rig.coordinator.image(run.id, "U1", 0) == b"picture"
    recordings = rig.coordinator.kept.recordings
    assert rig.workers.done[-1].file == recordings.frame_file(run.id, view.camera, view.row)
    # Only complete frames are kept; what the recording has is named.
    with pytest.raises(GoneError, match=r"its recording .* does not have it") as refusal:
        rig.coordinator.frame(run.id, 1, 1, allow_incomplete=True)
    assert f"vaoi cut {recordings.path_of(run.id)}" in refusal.value.action
    recordings._delete(run.id)
    with pytest.raises(GoneError, match="are no longer in memory"):
        rig.coordinator.frame(run.id, 1, 2)
    with pytest.raises(GoneError, match="are no longer in memory"):
        rig.coordinator.image(run.id, "U1", 0)


class Away:
    """Frames that are given to a later board after some copies."""

    def __init__(self, copies: int) -> None:
        self.copies = copies

    def bay_of(self, run: str) -> Any:
        if not self.copies:
            raise GoneError("The frames are no longer in memory.")
        return None

    def copier(self, bay: Any) -> Callable[[int], Any]:
        def copy(slot: int) -> Any:
            self.copies -= 1
            if not self.copies:
                raise GoneError("given to a later board")
            return np.zeros((48, 64), np.uint8)

        return copy


def a_keeper(rig: Any, tmp_path: Path, frames: Any, **limits: Any) -> Recordings:
    keep = KeepConfig().model_copy(update=limits)
    return Recordings(tmp_path / "kept", keep, rig.archive, rig.archive._events, frames)


@pytest.mark.parametrize("copies", [0, 1, 3])
def test_frames_that_are_needed_for_a_later_board_are_given_up(rig: Any, tmp_path: Path, copies: int) -> None:
    run = a_board(rig)
    keeper = a_keeper(rig, tmp_path, Away(copies))
    keeper.start()
    keeper.request(run.id)
    assert "needed for a later board" in wait_event(rig, run.id, "trouble", "recording-late")
    keeper.stop()
    assert keeper.counts.late == 1
    assert list((tmp_path / "kept").glob("*")) == []


def test_a_recording_is_offered_once_its_record_is_known_and_never_of_another_station(rig: Any, tmp_path: Path) -> None:
    run = a_board(rig)
    keeper = a_keeper(rig, tmp_path, rig.coordinator._frames)
    faults, offered = iter([None, DeviceError("The database cannot be read.")]), list[str]()
    keeper.on_kept = offered.append

    archive, origin = keeper._archive, Origin(station="other", exported="", imported="")

    def get(run: str) -> FinishedRun:
        if fault := next(faults, None):
            raise fault
        return archive.get(run)

    keeper._archive = Mock(wraps=archive, get=get)
    keeper.start()
    keeper.request(run.id)
    rig.wait_for(lambda: keeper._outdated == {run.id}, "the record is unknown")
    assert offered == []
    keeper.tend()
    rig.wait_for(lambda: offered == [run.id], "the record is known")
    finished = archive.get(run.id)
    elsewhere = replace(finished, detail=finished.detail.model_copy(update={"origin": origin}))
    keeper._archive = Mock(wraps=archive, get=lambda _run: elsewhere)
    keeper.offer_all()
    rig.wait_for(lambda: not keeper._updates, "the thread has taken it")
    keeper.stop()
    assert offered == [run.id]


@pytest.mark.parametrize("lost", [False, True])
def test_a_recording_gets_the_complete_result_and_is_offered_with_it(rig: Any, tmp_path: Path, lost: bool) -> None:
    run, archive, offered = a_board(rig), rig.archive, list[str]()
    whole = archive.get(run.id)
    first = whole.lean.model_copy(update={"quality": {**whole.lean.quality, "later": ["heights_mm"]}})
    archive._cache(replace(whole, stitch=first, document=stitch_text(first)))
    archive._unexplained.add(run.id)
    keeper = a_keeper(rig, tmp_path, rig.coordinator._frames)
    keeper.on_kept, archive.on_explained = offered.append, keeper.update
    keeper.start()
    keeper.request(run.id)
    wait_event(rig, run.id, "recording")
    rig.wait_for(lambda: not (keeper._waiting or keeper._updates), "the recording")
    result = tmp_path / "kept" / run.id / "result.json"
    assert "later" in read_stitch(result).quality
    assert offered == []
    archive.explain(run.id, None if lost else whole.text, "its worker has ended.")
    rig.wait_for(lambda: offered == [run.id], "the offer")
    keeper.stop()
    assert ("later" in read_stitch(result).quality) == lost


def test_a_result_that_is_completed_while_its_record_is_renewed_reaches_the_recording(
    rig: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The identity of a board is decided at about the same time."""
    run, archive, get = a_board(rig), rig.archive, rig.archive.get
    whole = get(run.id)
    first = whole.lean.model_copy(update={"quality": {**whole.lean.quality, "later": ["heights_mm"]}})
    archive._cache(replace(whole, stitch=first, document=stitch_text(first)))
    archive._unexplained.add(run.id)
    keeper = a_keeper(rig, tmp_path, rig.coordinator._frames)
    archive.on_explained = keeper.update
    keeper.start()
    keeper.request(run.id)
    wait_event(rig, run.id, "recording")
    rig.wait_for(lambda: not (keeper._waiting or keeper._updates), "the recording")

    def completed_meanwhile(of: str) -> Any:
        found = get(of)
        monkeypatch.setattr(archive, "get", get)
        archive.explain(of, whole.text)
        return found

    monkeypatch.setattr(archive, "get", completed_meanwhile)
    keeper.update(run.id)
    result = tmp_path / "kept" / run.id / "result.json"
    rig.wait_for(lambda: "later" not in read_stitch(result).quality, "the complete result")
    keeper.stop()


@pytest.mark.parametrize("cause", ["quota", "disk", "fault"])
def test_a_recording_without_room_is_refused_and_counted(
    rig: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cause: str
) -> None:
    run = a_board(rig)
    if cause == "disk":
        monkeypatch.setattr(module, "DISK_RESERVE", shutil.disk_usage(tmp_path).total)
    if cause == "fault":
        (tmp_path / "kept").write_text("no directory")
    keeper = a_keeper(rig, tmp_path, rig.coordinator._frames, **{"recordings_gb": 1e-9} if cause == "quota" else {})
    keeper.start()
    keeper.request(run.id)
    assert "not kept" in wait_event(rig, run.id, "trouble", "recording-refused")
    keeper.stop()
    assert keeper.counts.refused == 1


def test_recordings_make_room_on_a_disk_that_is_nearly_full(
    rig: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = a_board(rig)
    rig.coordinator.kept.pin(run.id)
    for name in ("0-old", run.id):
        (tmp_path / "kept" / name).mkdir(parents=True)
        (tmp_path / "kept" / name / module.HEAD_FILE).touch()
    keeper = a_keeper(rig, tmp_path, rig.coordinator._frames)
    monkeypatch.setattr(module, "DISK_RESERVE", 0)
    shutil.copytree(tmp_path / "kept" / run.id, tmp_path / "kept" / "failing")
    (tmp_path / "kept" / "failing" / module.HEAD_FILE).touch()

    def import_fails(path: Path) -> int:
        remove_directory(path)
        return size_below(path)

    with monkeypatch.context() as patch:
        patch.setattr(module, "readable_size_below", import_fails)
        keeper.tend()
    assert keeper.runs == 2
    monkeypatch.setattr(module, "DISK_RESERVE", 10**18)
    keeper.tend()
    assert [path.name for path in (tmp_path / "kept").iterdir()] == [run.id], "a pinned one stays"
