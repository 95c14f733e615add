"""Decisions about runs: kept, replaced, read without the disk, deleted with the run."""

from __future__ import annotations

import pytest

from tests.store.conftest import MakeRun
from vaoi_station.store import Store
from vaoi_station.store.history import decisions
from vaoi_station.store.history.decisions import RunDecisions


def test_a_later_decision_replaces_an_earlier_one(store: Store, make_run: MakeRun) -> None:
    store.save_run(make_run("r1", "ready")).result(10)
    assert store.decisions.documents(["r1"]) == {}
    assert store.decisions.save("r1", "first")
    assert store.decisions.save("r1", "second")
    assert not store.decisions.save("r2", "of an unknown run")
    assert store.decisions.documents(["r0", "r1", "r2"]) == {"r1": "second"}
    assert Store(store.database).decisions.documents(["r1"]) == {"r1": "second"}


def test_old_decisions_are_read_from_the_disk(store: Store, make_run: MakeRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decisions, "IN_MEMORY", 2)
    kept = RunDecisions(store.database)
    runs = [f"r{n}" for n in range(7)]
    for run in runs:
        store.save_run(make_run(run, "ready")).result(10)
        assert kept.save(run, f"about {run}")
        assert kept._newest is None or len(kept._newest) <= 4
    assert kept.documents(runs) == {run: f"about {run}" for run in runs}


def test_a_decision_is_deleted_with_its_run(store: Store, make_run: MakeRun) -> None:
    store.save_run(make_run("r1", "ready", finish_number=1)).result(10)
    store.decisions.save("r1", "x")
    store.retention.forget_details(["r1"]).result(10)
    store.retention.forget_runs(["r1"]).result(10)
    assert store.run("r1") is None
    assert Store(store.database).decisions.documents(["r1"]) == {}
