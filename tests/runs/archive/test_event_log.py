"""The event log: numbered without gaps, waited for, kept over restarts."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.runs.archive import event_log as module
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.store import Database, Store


def test_numbers_have_no_gaps_and_go_on_after_a_restart(tmp_path: Path) -> None:
    first = Store(Database(tmp_path / "s.db"))
    log = EventLog(first)
    for n in range(5):
        assert log.add("trouble", f"number {n}", code="x", action="Do.").number == n + 1
    first.close()
    second = Store(Database(tmp_path / "s.db"))
    log = EventLog(second)
    assert log.last == 5
    assert [e.message for e in log.read(2, 0, 100)] == ["number 2", "number 3", "number 4"]
    assert log.add("run", "new", run="r", state="ready").number == 6
    assert [e.number for e in log.read(0, 0, 3)] == [1, 2, 3]
    assert [e.number for e in log.read(5, 0, 3)] == [6]
    second.close()


def test_old_events_come_from_the_store(store: Store) -> None:
    log = EventLog(store)
    for n in range(module.RECENT + 5):
        log.add("run", str(n))
    store.set_state("no run", "gone").result(10)
    assert [e.number for e in log.read(module.RECENT, 0, 10)] == [module.RECENT + k for k in range(1, 6)]
    assert [e.number for e in log.read(1, 0, 2)] == [2, 3]


def test_the_latest_event_of_each_code_is_found_however_old_it_is(store: Store) -> None:
    log = EventLog(store)
    for code, state in (("a", "error"), ("b", "error"), ("a", "over"), ("b", "over")):
        log.add("fault", "x", code=code, state=state)
    log.add("run", "fault", code="c")
    store.set_state("no run", "gone").result(10)
    assert sorted((e.code, e.state) for e in log.latest("fault", 4)) == [("a", "over"), ("b", "error")]
