"""The small tables beside the runs: what is kept in each, for how long, and over a restart."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.store.conftest import NOW, MakeRun, noise
from vaoi_station.errors import InternalError, NotFoundError, StateError
from vaoi_station.store import Database, RunRow, Store, documents
from vaoi_station.store.documents import IdentityRow


@settings(max_examples=15, deadline=None)
@given(
    total=st.integers(0, 7),
    kept=st.tuples(st.integers(0, 3), st.integers(1, 3)),
    asked=st.tuples(st.integers(0, 4), st.integers(0, 4)),
)
def test_the_first_and_the_latest_checks_of_a_calibration_are_kept(
    tmp_path_factory: pytest.TempPathFactory, total: int, kept: tuple[int, int], asked: tuple[int, int]
) -> None:
    """The reference: a list that is thinned after every save."""
    store = Store(Database(tmp_path_factory.mktemp("checks") / "station.db"))
    calibration, other = (store.keep_document("calibration", text, NOW) for text in ("{}", "[]"))
    board_type = store.keep_document("board-type", "{}", NOW)
    expected: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(documents, "FIRST_KEPT", kept[0])
        patch.setattr(documents, "LATEST_KEPT", kept[1])
        for number in range(total):
            run = f"r{number}"
            store.save_run(RunRow(run, "ready", None, board_type, calibration, "{}", "{}"))
            store.checks.save(run, calibration, "earlier")
            store.checks.save(run, calibration, run).result(10)
            expected = list(dict.fromkeys([*expected, run][: kept[0]] + [*expected, run][-kept[1] :]))
    latest = expected[-asked[1] :] if asked[1] else []
    assert store.checks.documents(calibration, *asked) == sorted({*expected[: asked[0]], *latest})
    assert (store.checks.count(calibration), store.checks.count(other)) == (len(expected), 0)
    with pytest.raises(InternalError, match="FOREIGN KEY"):
        store.checks.save("of no run", calibration, "{}").result(10)
    store.close()


def test_a_later_decision_replaces_an_earlier_one_and_goes_with_its_run(store: Store, make_run: MakeRun) -> None:
    store.save_run(make_run("r1", "ready", finish_number=1)).result(10)
    assert store.decisions(["r1"]) == {}
    assert store.save_decision("r1", "first")
    assert store.save_decision("r1", "second")
    assert not store.save_decision("r2", "of an unknown run")
    assert store.decisions(["r0", "r1", "r2"]) == {"r1": "second"}
    store.retention.forget_details(["r1"]).result(10)
    store.retention.forget_runs(["r1"]).result(10)
    assert store.run("r1") is None
    assert store.decisions(["r1"]) == {}


def test_identities_are_replaced_and_runs_found_by_their_ids(store: Store, make_run: MakeRun) -> None:
    for number, run in enumerate(("r1", "r2", "r3"), 1):
        store.save_run(make_run(run, "ready", number))
        store.identities.save(run, IdentityRow(json.dumps({"n": number}), ["A", "B"]), "{}", "ready")
    store.identities.save("r2", IdentityRow(noise(4000), ["C"]), "{}", "ready")
    store.identities.save("unknown", IdentityRow("{}", ["A"]), "{}", "ready").result(10)
    assert [store.identities.document(run) for run in ("r1", "r2", "r9")] == ['{"n": 1}', noise(4000), None]
    assert store.identities.runs_of("A", 9, None) == ["r3", "r1"]
    assert store.identities.runs_of("A", 9, "r3") == ["r1"]
    assert store.identities.runs_of("B", 1, None) == ["r3"]
    assert store.identities.runs_of("C", 9, None) == ["r2"]


def test_a_run_gets_the_verdict_that_its_identity_leaves_and_is_kept_as_doubtful(
    store: Store, make_run: MakeRun
) -> None:
    row = replace(make_run("r1", "ready", 1), summary='{"verdict": "ok"}', identity=IdentityRow("{}", pending=True))
    store.save_run(row).result(10)
    assert (store.identities.pending(), store.retention.whole()) == (["r1"], (1, 0))
    store.identities.save("r1", IdentityRow("{}"), '{"verdict": "degraded"}', "degraded").result(10)
    assert (store.identities.pending(), store.retention.whole()) == ([], (0, 1))
    stored = store.run("r1")
    assert stored is not None
    assert (stored.state, stored.summary) == ("degraded", '{"verdict": "degraded"}')
    store.set_state("r1", "gone")
    store.identities.save("r1", IdentityRow("{}"), '{"verdict": "ok"}', "ready").result(10)
    assert store.retention.whole() == (1, 0)
    assert [run.state for run in store.runs(9, None)] == ["gone"], "its frames do not come back"


@pytest.mark.parametrize("name", ["'; DROP TABLE board_methods; --", "größer a/b"])
def test_reference_and_method_of_a_board_type_are_kept_apart_and_over_a_restart(path: Path, name: str) -> None:
    store = Store(Database(path))
    assert (store.references.get(name), store.methods.get(name)) == (None, None)
    for document in ("first", "second"):
        store.references.set(name, document)
        store.methods.set(name, "features")
    store.references.set("other", "of another one")
    store.close()
    store = Store(Database(path))
    assert (store.references.get(name), store.methods.get(name)) == ("second", "features")
    assert sorted(store.references.all()) == ["of another one", "second"]
    store.references.set("never", None).result(10)
    store.references.set(name, None).result(10)
    assert (store.references.get(name), store.methods.get(name)) == (None, "features")
    store.close()
    with pytest.raises(StateError, match="is closed"):
        store.references.set("a", "document")


def test_a_configuration_is_stored_once(store: Store, database: Database) -> None:
    assert store.configurations.present == ""
    first = store.configurations.begin('{"a": 1}', "2026")
    assert store.configurations.begin('{"a": 1}', "2027") == first
    second = store.configurations.begin('{"a": 2}', "2028")
    assert store.configurations.present == second != first
    assert store.configurations.document(first) == '{"a": 1}'
    assert database.value("SELECT count(*) FROM configurations") == 2
    database.execute("DELETE FROM configurations").result(10)
    store.configurations.store_again("2029")
    assert store.configurations.document(second) == '{"a": 2}'
    with pytest.raises(NotFoundError, match="no configuration 'x'"):
        store.configurations.document("x")
