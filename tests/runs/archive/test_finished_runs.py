"""Finished runs: over restarts, in order, and when the disk is full."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.acquisition.process.messages import Grant
from vaoi_station.errors import DeviceError, GoneError, NotFoundError
from vaoi_station.model import Status
from vaoi_station.runs.archive import finished_runs as module
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.store import Database, Store


def test_results_and_records_survive_a_restart_and_frames_do_not(
    make_rig: Callable[..., Any], tmp_path: Path, store: Store
) -> None:
    rig = make_rig()
    rig.ready()
    grant = rig.arm(board_id="b 1")
    rig.board(grant)
    before = rig.result_of(grant.run)
    stitch, timeline = rig.coordinator.stitch(grant.run), rig.coordinator.timeline(grant.run)
    half = rig.peer.expect(Grant)
    rig.begin(half)
    rig.wait_run(half.run, lambda run: run.state == "filming", "the second board")
    store.set_state("no run", "gone").result(10)

    later = Store(Database(tmp_path / "data" / "station.db"))
    archive = Archive(later, EventLog(later))
    finished = archive.get(grant.run)
    assert finished.detail == before.model_copy(
        update={"state": "gone", "frames_available": False, "frames_kept_until": None}
    )
    assert finished.result.model_dump_json() == stitch.model_dump_json()
    assert finished.timeline == timeline
    assert finished.board_type.components[0].ref == "U1"
    assert (
        finished.cameras[1].image_from_row.matrix.tolist()
        == rig.coordinator._core.runs.filming[0].order.setup.cameras[1].image_from_row.matrix.tolist()
    )
    lost = archive.get(half.run)
    assert (lost.detail.state, lost.detail.verdict, lost.stitch) == ("gone", None, None)
    assert lost.detail.reasons[-1].code == "station-restarted"
    latest = archive.latest()
    assert latest is not None
    assert latest.detail.id == half.run
    assert [run.id for run in archive.list(10, None)] == [half.run, grant.run]
    assert [run.id for run in archive.list(10, half.run)] == [grant.run]
    following = archive.next(grant.run, 0.0)
    assert following is not None
    assert following.detail.id == half.run
    later.close()


def test_frames_from_before_a_restart_are_gone(make_rig: Callable[..., Any]) -> None:
    first = make_rig(runs=2)
    first.ready()
    grant = first.arm()
    first.board(grant)
    first.result_of(grant.run)
    first.coordinator.close()
    first.ring.close()
    second = make_rig(runs=2)
    assert second.coordinator.run(grant.run).state == "gone"
    with pytest.raises(GoneError, match="no longer in memory"):
        second.coordinator.frame(grant.run, 0, 0)
    with pytest.raises(GoneError, match="no longer in memory"):
        second.coordinator.image(grant.run, "U1", 0)
    with pytest.raises(GoneError, match="no longer in memory"):
        second.coordinator.hold(grant.run, "me", "late")
    assert second.coordinator.stitch(grant.run).status is Status.OK
    assert second.coordinator.release(grant.run).state == "gone"


def test_a_full_disk_is_reported_and_the_result_stays_available(rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> Future[None]:
        refused: Future[None] = Future()
        refused.set_exception(DeviceError("station.db: cannot be used (disk is full)."))
        return refused

    monkeypatch.setattr(rig.store, "save_run", refuse)
    grant = rig.arm()
    rig.board(grant)
    assert rig.result_of(grant.run).state == "ready"
    assert rig.coordinator.stitch(grant.run).status is Status.OK
    assert any("disk is full" in e.message for e in rig.coordinator.events() if e.kind == "trouble")


def test_runs_that_are_not_cached_are_read_from_the_database(rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CACHED_RUNS", 1)
    grant, runs = rig.arm(), []
    for _ in range(3):
        rig.board(grant)
        rig.result_of(grant.run)
        runs.append(grant.run)
        grant = rig.peer.expect(Grant)
    assert [rig.coordinator.run(run).id for run in runs] == runs
    assert rig.coordinator.stitch(runs[0]).status is Status.OK
    assert rig.coordinator.next_run(runs[0], 0.0).id == runs[1]
    assert [run.id for run in rig.coordinator.runs(2)] == runs[:0:-1]
    with pytest.raises(NotFoundError):
        rig.coordinator.next_run("never", 0.0)
