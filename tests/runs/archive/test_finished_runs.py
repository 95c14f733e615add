"""Finished runs: over restarts, in order, and when the disk is full."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from vaoi_station.acquisition.process.messages import Grant
from vaoi_station.errors import DeviceError
from vaoi_station.model import Status
from vaoi_station.runs.archive import finished_runs as module
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.states.schemas import VerdictCounts
from vaoi_station.store import Database, Store, schema


def test_results_and_records_survive_a_restart_and_frames_do_not(
    make_rig: Callable[..., Any], tmp_path: Path, store: Store
) -> None:
    rig = make_rig()
    rig.ready()
    grant = rig.arm(board_id="b 1")
    rig.board(grant)
    rig.result_of(grant.run)
    # A disk that is slow beside other tests has it announced before it is stored.
    rig.wait_run(grant.run, lambda run: run.stored, "the first board to be on disk")
    before = rig.coordinator.run(grant.run)
    stitch, timeline = rig.coordinator.stitch(grant.run), rig.coordinator.timeline(grant.run)
    half = rig.peer.expect(Grant)
    rig.begin(half)
    rig.wait_run(half.run, lambda run: run.state == "filming", "the second board")
    assert (rig.archive.count_unstored(), rig.archive.count_at_risk()) == (0, 1)
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
        == rig.coordinator._core.filming[0].order.setup.cameras[1].image_from_row.matrix.tolist()
    )
    lost = archive.get(half.run)
    assert (lost.detail.state, lost.detail.verdict, lost.stitch) == ("gone", "failed", None)
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


@pytest.mark.parametrize(("column", "table"), [("timeline", "runs"), ("head", "runs"), ("document", "documents")])
def test_a_run_of_which_a_part_is_damaged_is_refused_as_such(
    make_rig: Callable[..., Any], store: Store, column: str, table: str
) -> None:
    rig = make_rig()
    rig.ready()
    grant = rig.arm()
    rig.board(grant)
    rig.result_of(grant.run)
    damaged = f"UPDATE {table} SET {column} = '{{}}'" + (", packed_timeline = NULL" if column == "timeline" else "")
    store.database.write(lambda c: c.execute(damaged)).result(10)
    restarted = Store(store.database)  # without the documents that this one has in memory
    archive = Archive(restarted, EventLog(restarted))
    with pytest.raises(DeviceError, match="cannot be read") as refusal:
        archive.get(grant.run)
    assert refusal.value.code == "record-unreadable"


@pytest.fixture(autouse=True)
def not_packed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The small documents of a test would fit into pages that the database has already."""
    monkeypatch.setattr(schema, "_SMALLEST", 10**9)


def fill(store: Store) -> None:
    """Let the database grow no further: SQLite then reports what it reports on a full disk."""
    store.database.write(lambda c: c.execute("PRAGMA max_page_count = 1").fetchall()).result(20)


def make_room(store: Store) -> None:
    assert store.database._writer is not None
    store.database._writer.execute("PRAGMA max_page_count = 1000000").fetchall()


def test_boards_are_announced_from_memory_while_the_disk_is_full_and_written_afterwards(
    make_rig: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "CACHED_RUNS", 1)
    rig = make_rig(runs=2)
    rig.ready()
    grant, runs = rig.arm(), []
    fill(rig.store)
    for _ in range(4):
        rig.board(grant)
        shown = rig.result_of(grant.run)
        assert shown.stored is False
        runs.append(grant.run)
        grant = rig.peer.expect(Grant)
    assert [warning.code for warning in rig.coordinator.snapshot().warnings] == ["storage-full"]
    assert "4 finished runs wait in memory" in rig.coordinator.snapshot().warnings[0].message
    announced = [e for e in rig.coordinator.events() if e.kind == "run" and e.state == "ready"]
    assert [e.run for e in announced] == runs
    assert all("not on disk yet" in e.message for e in announced)
    assert [run.id for run in rig.coordinator.runs()] == runs[::-1]
    assert rig.coordinator.stitch(runs[0]).status is Status.OK
    assert rig.coordinator.next_run(runs[0], 0.0).id == runs[1]
    assert rig.coordinator.run(runs[0]).state == "gone", "its memory was given to a later board"
    make_room(rig.store)
    rig.wait_for(lambda: not rig.coordinator.snapshot().warnings, "the database to be written")
    rig.wait_run(runs[-1], lambda run: run.stored, "the last run to be on disk")
    assert [row.state for row in rig.store.runs(10, None)] == ["ready", "gone", "gone", "gone"]
    assert [e.run for e in rig.coordinator.events() if e.code == "stored"] == runs


def test_a_start_accepts_what_a_full_disk_left(make_rig: Callable[..., Any], tmp_path: Path) -> None:
    """The run's memory was taken before its end could be written, and then the station died."""
    rig = make_rig(runs=2)
    rig.ready()
    grant, runs = rig.arm(), []
    rig.begin(grant)
    rig.wait_run(grant.run, lambda run: run.state == "filming", "the board")
    rig.store.database.write(lambda _: None).result(20)
    fill(rig.store)
    rig.finish(grant, [r for row in range(3) for r in rig.row(grant, row)])
    runs.append(grant.run)
    for _ in range(2):
        grant = rig.peer.expect(Grant)
        rig.board(grant)
        rig.result_of(grant.run)
        runs.append(grant.run)
    assert rig.coordinator.run(runs[0]).state == "gone"
    later = tmp_path / "later"
    shutil.copytree(tmp_path / "data", later)
    found = Store(Database(later / "station.db"))
    archive = Archive(found, EventLog(found))
    listed = archive.list(9, None)
    assert listed[-1].id == runs[0]
    assert {run.state for run in listed} == {"gone"}
    assert found.unfinished() == []
    found.close()


def test_a_start_on_a_full_disk_closes_runs_in_memory_and_writes_them_later(store: Store, progress: Any) -> None:
    Archive(store, EventLog(store)).begin(progress)
    store.database.write(lambda c: c.execute("PRAGMA query_only = 1")).result(20)
    archive = Archive(store, EventLog(store))
    assert [(run.id, run.state) for run in archive.list(9, None)] == [("r1", "gone")]
    detail = archive.get("r1").detail
    assert (detail.state, detail.stored, detail.reasons[-1].code) == ("gone", False, "station-restarted")
    assert [row.id for row in store.unfinished()] == ["r1"]
    assert store.database._writer is not None
    store.database._writer.execute("PRAGMA query_only = 0")
    store.database.write(lambda _: None, patient=True).result(20)
    assert store.unfinished() == []
    assert archive.get("r1").detail.stored


def test_a_run_that_will_never_be_written_is_named(rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> Future[None]:
        refused: Future[None] = Future()
        refused.set_exception(DeviceError("station.db: cannot be used (disk is full)."))
        return refused

    monkeypatch.setattr(rig.store, "save_run", refuse)
    grant = rig.arm()
    rig.board(grant)
    assert (rig.result_of(grant.run).state, rig.result_of(grant.run).stored) == ("ready", False)
    assert rig.coordinator.stitch(grant.run).status is Status.OK
    assert any("disk is full" in e.message for e in rig.coordinator.events() if e.code == "store")


def run(verdict: Status | None, waited_s: float | None) -> tuple[Any, Any]:
    detail = SimpleNamespace(verdict=verdict, counts=VerdictCounts(ok=10, incomplete=1, missing=0))
    return detail, SimpleNamespace(last_frame_s=2.0, ready_s=None if waited_s is None else 2.0 + waited_s)
