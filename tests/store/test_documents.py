"""Runs, results, events, documents."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from vaoi_station.errors import InternalError, NotFoundError
from vaoi_station.store import Database, EventRow, RunRow, Store
from vaoi_station.store import documents as module


def row_of(store: Store, run: str, state: str = "filming", finish_number: int | None = None) -> RunRow:
    board_type = store.keep_document("board-type", '{"name": "b"}', "2026-01-01T00:00:00Z")
    calibration = store.keep_document("calibration", '{"n": 1}', "2026-01-01T00:00:00Z")
    return RunRow(run, state, finish_number, board_type, calibration, '{"s": 1}', '{"d": 1}')


def test_a_run_from_its_beginning_to_its_result(store: Store) -> None:
    row = row_of(store, "r1")
    store.save_run(row).result(10)
    assert store.run("r1") == row
    assert store.unfinished() == [row]
    assert store.result("r1") is None
    done = replace(row, state="ready", finish_number=1, summary='{"s": 2}', head='{"h": 1}')
    store.save_run(done, '{"t": 1}', '{"m": 1}').result(10)
    assert store.run("r1") == done
    assert (store.result("r1"), store.timeline("r1")) == ('{"m": 1}', '{"t": 1}')
    assert store.unfinished() == []
    assert store.run("r2") is None
    assert store.timeline("r2") is None


def test_a_result_never_changes(store: Store, database: Database) -> None:
    row = row_of(store, "r1", "ready", 1)
    store.save_run(row, None, '{"m": 1}').result(10)
    with pytest.raises(InternalError):
        store.save_run(row, None, '{"m": 2}').result(10)
    with pytest.raises(InternalError, match="a result never changes"):
        database.write(lambda c: c.execute("UPDATE results SET document = 'x'")).result(10)
    assert store.result("r1") == '{"m": 1}'


def test_runs_are_listed_by_age_and_followed_by_their_ends(store: Store) -> None:
    for number, run in ((2, "r1"), (1, "r2"), (None, "r3")):
        store.save_run(row_of(store, run, "ready", number)).result(10)
    assert [row.id for row in store.runs(2, None)] == ["r3", "r2"]
    assert [row.id for row in store.runs(9, "r3")] == ["r2", "r1"]
    first = store.finished_after(0)
    assert first is not None
    assert first.id == "r2"
    second = store.finished_after(1)
    assert second is not None
    assert second.id == "r1"
    assert store.finished_after(2) is None
    last = store.last_finished()
    assert last is not None
    assert last.id == "r1"
    assert store.newest_run() == "r3"


def test_an_empty_store_says_so(store: Store) -> None:
    assert store.last_finished() is None
    assert store.newest_run() is None
    assert store.last_event() == 0
    with pytest.raises(NotFoundError, match="no document 0000"):
        store.document("0000")


def test_what_is_written_is_there_after_a_restart(store: Store, database: Database, path: Path) -> None:
    store.save_run(row_of(store, "r1", "ready", 1), '{"t": 1}', '{"m": 1}')
    store.add_event(EventRow(1, '{"e": 1}'))
    database.close()
    later = Store(Database(path))
    assert later.result("r1") == '{"m": 1}'
    assert later.events(0, 10) == [EventRow(1, '{"e": 1}')]
    later.mark_frames_gone("gone").result(10)
    row = later.run("r1")
    assert row is not None
    assert row.state == "gone"
    later.close()


def test_documents_are_kept_once(store: Store, database: Database) -> None:
    first = store.keep_document("calibration", "{}", "then")
    assert store.keep_document("calibration", "{}", "later") == first
    assert store.document(first) == "{}"
    assert [tuple(r) for r in database.read("SELECT kind, first_seen FROM documents")] == [("calibration", "then")]


def test_of_very_many_events_the_oldest_go(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "EVENTS_KEPT", 100)
    for number in (1, 899, 900, 901, 1000):
        store.add_event(EventRow(number, "{}"))
    store.set_state("nobody", "gone").result(10)
    assert [row.number for row in store.events(0, 100)] == [901, 1000]
    assert store.last_event() == 1000
