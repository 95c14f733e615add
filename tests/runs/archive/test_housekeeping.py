"""Tasks that fail do not end housekeeping, and each failure is published once."""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import pytest

from tests.store.conftest import noise
from vaoi_station.config import KeepConfig
from vaoi_station.errors import DeviceError
from vaoi_station.runs.archive import housekeeping as module
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.housekeeping import DAY_S, Housekeeping, Retention
from vaoi_station.runs.states.run_ids import earliest_id, utc
from vaoi_station.store import RunRow, Store
from vaoi_station.store import retention as store_module

PATIENCE_S = 20.0


class Task:
    """A task that raises `failure`, and counts its calls."""

    def __init__(self) -> None:
        self.failure: Exception | None = None
        self.calls = threading.Semaphore(0)

    def __call__(self) -> None:
        self.calls.release()
        if self.failure is not None:
            raise self.failure

    def wait(self, calls: int = 2) -> None:
        for _ in range(calls):
            assert self.calls.acquire(timeout=PATIENCE_S)


@pytest.mark.parametrize("failure", [DeviceError("The disk is full.", action="Free it."), OSError("odd")])
def test_a_failure_is_published_once_and_the_task_is_called_again(store: Store, failure: Exception) -> None:
    events, task = EventLog(store), Task()
    housekeeping = Housekeeping(events)
    housekeeping.add(task, 0.001, code="chore")
    housekeeping.start()
    task.failure = failure
    task.wait(5)
    assert [event.code for event in events.read(0, PATIENCE_S, 10)] == ["chore"]
    assert len(housekeeping.faults()) == 1
    task.failure = None
    task.wait(30)
    assert housekeeping.faults() == ()
    task.failure = failure
    task.wait(30)
    housekeeping.stop()
    assert [event.code for event in events.read(0, 0.0, 10)] == ["chore", "chore"]


NOW_S = 1_700_000_000.0


def keep(**limits: Any) -> KeepConfig:
    """Limits without those of the file format, which are too high for a test."""
    return KeepConfig().model_copy(update=limits)


@pytest.fixture
def add(store: Store) -> Callable[..., list[str]]:
    digest = store.keep_document("board-type", "{}", "")

    def add(*ages_days: float, verdict: str = "ok", kilobytes: int = 1) -> list[str]:
        ids = []
        for age in ages_days:
            run = earliest_id(NOW_S - age * DAY_S) + "-abcdef"
            number = sum(store.retention.whole()) + 1
            row = RunRow(run, "gone", number, digest, digest, f'{{"verdict": "{verdict}"}}', "{}")
            store.save_run(row, None, '"' + noise(1000 * kilobytes) + '"').result(10)
            ids.append(run)
        return ids

    return add


@pytest.fixture(autouse=True)
def none_protected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store_module, "NEVER_FORGOTTEN", 1)


def whole(store: Store, runs: list[str]) -> list[bool]:
    return [store.result(run) is not None for run in runs]


def test_runs_are_forgotten_by_age_and_verdict(store: Store, add: Callable[..., list[str]]) -> None:
    sound = add(500, 70, 50, 1)
    doubtful = add(501, 71, 51, 2, verdict="failed")
    retention = Retention(keep(days=60, doubtful_days=400, run_days=400), store.retention)
    assert retention.sweep(NOW_S) == 5, "details of three runs, then two of these completely"
    assert whole(store, sound) == [False, False, True, True]
    assert whole(store, doubtful) == [False, True, True, True]
    assert store.run(sound[0]) is store.run(doubtful[0]) is None
    assert store.run(sound[1]) is not None
    assert retention.sweep(NOW_S) == 0


def test_on_a_full_disk_the_oldest_runs_make_some_room_in_the_file(
    store: Store, add: Callable[..., list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = add(*range(20, 0, -1), kilobytes=100)
    monkeypatch.setattr(module, "BATCH", 1)
    monkeypatch.setattr(module, "SPARE_BYTES", 290_000)
    retention = Retention(keep(), store.retention)
    assert retention.sweep(NOW_S) == 0, "the disk has room"
    monkeypatch.setattr(module, "SHORT_BYTES", 10**18)
    assert retention.sweep(NOW_S) == 3
    assert whole(store, runs) == [False] * 3 + [True] * 17
    assert retention.sweep(NOW_S) == 0, "whatever fills the disk, the history is not given up for it"


def test_a_clock_that_jumps_ahead_deletes_little_at_a_time(
    store: Store, add: Callable[..., list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = add(*range(30, 0, -1))
    monkeypatch.setattr(module, "BATCH", 2)
    monkeypatch.setattr(module, "MOST_BATCHES", 3)
    assert Retention(keep(), store.retention).sweep(NOW_S + 1000 * DAY_S) == 6
    assert whole(store, runs).count(False) == 6


def test_documents_that_no_run_refers_to_are_forgotten_after_a_week(
    store: Store, add: Callable[..., list[str]]
) -> None:
    def known() -> set[str]:
        return {row["document"] for row in store.database.read("SELECT document FROM documents")}

    day = [utc(datetime.fromtimestamp(NOW_S - age * DAY_S, UTC)) for age in range(10)]
    add(20)
    for document, since in (('"old"', day[8]), ('"new"', day[6])):
        store.keep_document("calibration", document, since)
    for document, used in (("1", day[9]), ("2", day[1])):
        store.configurations.begin(document, used)
    retention = Retention(keep(), store.retention)
    retention.forget_unused(NOW_S)
    assert known() == {"{}", '"new"'}, "a run refers to {}"
    digests = [row["document"] for row in store.database.read("SELECT document FROM configurations")]
    assert digests == ["1", "2"], "the run of twenty days ago may have been made with the first"
    store.database.write(lambda c: c.execute("DELETE FROM whole_runs")).result(10)
    store.database.write(lambda c: c.execute("DELETE FROM results")).result(10)
    store.database.write(lambda c: c.execute("DELETE FROM runs")).result(10)
    retention.forget_unused(NOW_S)
    assert [row["document"] for row in store.database.read("SELECT document FROM configurations")] == ["2"]
    assert known() == {'"new"'}
