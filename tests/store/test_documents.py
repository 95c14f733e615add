"""Runs, results, events and documents of the store."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.store.conftest import MakeRun
from vaoi_station.errors import InternalError
from vaoi_station.store import Database, Store
from vaoi_station.store import documents as module


def test_long_documents_are_packed_and_those_of_earlier_versions_are_read(
    store: Store, database: Database, make_run: MakeRun
) -> None:
    detail, timeline, result = (json.dumps([{"name": name, "n": n} for n in range(99)]) for name in "dtr")
    row = replace(make_run("r1", "ready", 1), detail=detail)
    store.save_run(row, timeline, result).result(10)
    [stored] = database.read("SELECT detail, timeline, document FROM runs JOIN results ON run = id")
    assert tuple(stored) == ("packed",) * 3
    assert (store.run("r1"), store.timeline("r1"), store.result("r1")) == (row, timeline, result)
    assert store.runs(9, None)[0].detail, "only that of a forgotten run is empty"
    database.write(
        lambda c: c.execute(
            "UPDATE runs SET detail = ?, packed_detail = NULL, timeline = ?, packed_timeline = NULL", (detail, timeline)
        )
    ).result(10)
    assert (store.run("r1"), store.timeline("r1")) == (row, timeline)
    database.write(lambda c: c.execute("UPDATE runs SET detail = 'packed', packed_detail = x'00'")).result(10)
    damaged = store.run("r1")
    assert damaged is not None
    assert damaged.detail == "packed", "no JSON: it is shown as a record that cannot be read"


def test_a_result_never_changes(store: Store, database: Database, make_run: MakeRun) -> None:
    row = make_run("r1", "ready", 1)
    store.save_run(row, None, '{"m": 1}').result(10)
    with pytest.raises(InternalError):
        store.save_run(row, None, '{"m": 2}').result(10)
    with pytest.raises(InternalError, match="a result never changes"):
        database.write(lambda c: c.execute("UPDATE results SET document = 'x'")).result(10)
    assert store.result("r1") == '{"m": 1}'


def test_a_result_is_replaced_only_by_its_complete_form_and_not_made_anew(store: Store, make_run: MakeRun) -> None:
    store.save_run(make_run("r1", "ready", 1), None, '{"m": 1}').result(10)
    store.complete_result("r1", '{"m": 1, "more": 2}').result(10)
    store.complete_result("r2", '{"m": 3}').result(10)
    assert (store.result("r1"), store.result("r2")) == ('{"m": 1, "more": 2}', None)


def test_runs_are_listed_by_id_and_followed_by_finish_number(store: Store, make_run: MakeRun) -> None:
    for number, run in ((2, "r1"), (1, "r2"), (None, "r3")):
        store.save_run(make_run(run, "ready", number)).result(10)
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


def test_written_data_survive_a_restart(store: Store, database: Database, path: Path, make_run: MakeRun) -> None:
    store.save_run(make_run("r1", "ready", 1), '{"t": 1}', '{"m": 1}')
    store.add_event(1, '{"e": 1}')
    database.close()
    later = Store(Database(path))
    assert later.result("r1") == '{"m": 1}'
    assert later.events(0, 10) == ['{"e": 1}']
    later.mark_frames_gone("gone").result(10)
    row = later.run("r1")
    assert row is not None
    assert row.state == "gone"
    later.close()


def test_the_oldest_events_are_deleted(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "EVENTS_KEPT", 100)
    for number in (1, 899, 900, 901, 1000):
        store.add_event(number, str(number))
    store.set_state("unknown", "gone").result(10)
    assert store.events(0, 100) == ["901", "1000"]
    assert store.last_event() == 1000


def test_events_are_read_in_order_from_a_number_on(store: Store) -> None:
    for number in (1, 2, 3):
        store.add_event(number, f'"{number}"').result(10)
    assert store.events(1, 10) == ['"2"', '"3"']
    assert store.events(0, 2) == ['"1"', '"2"']
    assert store.events(3, 10) == []


def test_the_end_of_a_run_survives_a_power_failure_before_it_is_announced(store: Store, make_run: MakeRun) -> None:
    levels: list[int] = []
    row = make_run("r1", "ready", 1)
    store.database.write(lambda c: c.create_function("seen", 1, levels.append), patient=True).result(10)
    store.database.write(
        lambda c: c.execute(
            "CREATE TEMP TRIGGER watch AFTER INSERT ON runs BEGIN SELECT seen((SELECT * FROM pragma_synchronous)); END"
        )
    ).result(10)
    store.save_run(row).result(10)
    store.save_run(make_run("r2")).result(10)
    assert levels == [2, 1], "FULL for a run that ended, NORMAL for one that began"


@pytest.mark.parametrize("what", ["heights", "parts"])
def test_measures_are_deleted_with_the_result_and_do_not_come_back(store: Store, make_run: MakeRun, what: str) -> None:
    read, save = getattr(store, what), getattr(store, f"save_{what}")
    store.save_run(make_run("r1"))
    save("r1", "{}").result(10)
    assert read("r1") is None, "the run has not ended"
    store.save_run(make_run("r1", "ready", 1))
    save("r1", "{}").result(10)
    assert read("r1") == "{}"
    store.retention.forget_details(["r1"]).result(10)
    assert read("r1") is None
    save("r1", "{}").result(10)
    assert read("r1") is None
    store.retention.forget_runs(["r1"]).result(10)
    assert store.run("r1") is None
