"""Identities of runs in the database."""

from __future__ import annotations

import json

from tests.store.conftest import MakeRun, noise
from vaoi_station.store import Store


def test_identities_are_replaced_and_runs_found_by_their_ids(store: Store, make_run: MakeRun) -> None:
    for number, run in enumerate(("r1", "r2", "r3"), 1):
        store.save_run(make_run(run, "ready", number))
        store.identities.save(run, json.dumps({"n": number}), ["A", "B"])
    store.identities.save("r2", noise(4000), ["C"])
    store.identities.save("unknown", "{}", ["A"]).result(10)
    assert store.identities.documents(["r1", "r2", "r9"]) == {"r1": '{"n": 1}', "r2": noise(4000)}
    assert store.identities.documents([]) == {}
    assert store.identities.runs_of("A", 9, None) == ["r3", "r1"]
    assert store.identities.runs_of("A", 9, "r3") == ["r1"]
    assert store.identities.runs_of("B", 1, None) == ["r3"]
    assert store.identities.runs_of("C", 9, None) == ["r2"]


def test_identity_stays_with_the_summary_and_goes_with_the_run(store: Store, make_run: MakeRun) -> None:
    store.save_run(make_run("r1", "ready", 1))
    store.identities.save("r1", "{}", ["A"])
    store.retention.forget_details(["r1"]).result(10)
    assert store.identities.runs_of("A", 9, None) == ["r1"]
    store.retention.forget_runs(["r1"]).result(10)
    assert store.identities.runs_of("A", 9, None) == []
    assert store.identities.documents(["r1"]) == {}
