"""Identities of runs in the database."""

from __future__ import annotations

import json
from dataclasses import replace

from tests.store.conftest import MakeRun, noise
from vaoi_station.store import Store
from vaoi_station.store.history.identities import IdentityRow


def test_identities_are_replaced_and_runs_found_by_their_ids(store: Store, make_run: MakeRun) -> None:
    for number, run in enumerate(("r1", "r2", "r3"), 1):
        store.save_run(make_run(run, "ready", number))
        store.identities.save(run, IdentityRow(json.dumps({"n": number}), ["A", "B"]))
    store.identities.save("r2", IdentityRow(noise(4000), ["C"]))
    store.identities.save("unknown", IdentityRow("{}", ["A"])).result(10)
    assert store.identities.documents(["r1", "r2", "r9"]) == {"r1": '{"n": 1}', "r2": noise(4000)}
    assert store.identities.documents([]) == {}
    assert store.identities.runs_of("A", 9, None) == ["r3", "r1"]
    assert store.identities.runs_of("A", 9, "r3") == ["r1"]
    assert store.identities.runs_of("B", 1, None) == ["r3"]
    assert store.identities.runs_of("C", 9, None) == ["r2"]


def test_identity_stays_with_the_summary_and_goes_with_the_run(store: Store, make_run: MakeRun) -> None:
    store.save_run(make_run("r1", "ready", 1))
    store.identities.save("r1", IdentityRow("{}", ["A"]))
    store.retention.forget_details(["r1"]).result(10)
    assert store.identities.runs_of("A", 9, None) == ["r1"]
    store.retention.forget_runs(["r1"]).result(10)
    assert store.identities.runs_of("A", 9, None) == []
    assert store.identities.documents(["r1"]) == {}


def test_run_has_its_identity_as_soon_as_it_is_stored_and_is_kept_as_doubtful(store: Store, make_run: MakeRun) -> None:
    row = replace(make_run("r1", "ready", 1), summary='{"verdict": "ok"}', identity=IdentityRow("{}", pending=True))
    store.save_run(row).result(10)
    assert (store.identities.pending(), store.retention.whole()) == (["r1"], (1, 0))
    store.identities.save("r1", IdentityRow("{}", degrading=["board-id-differs"])).result(10)
    assert (store.identities.pending(), store.retention.whole()) == ([], (0, 1))
    store.identities.save("r1", IdentityRow("{}")).result(10)
    assert store.retention.whole() == (1, 0)
