"""Calibration checks are kept per calibration: the first and the latest ones."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.store.conftest import NOW, MakeRun
from vaoi_station.errors import InternalError
from vaoi_station.store import Database, RunRow, Store
from vaoi_station.store.history import calibration_checks as module
from vaoi_station.store.history.calibration_checks import CalibrationChecks


@pytest.fixture
def checks(store: Store) -> CalibrationChecks:
    return store.checks


def save(store: Store, make_run: MakeRun, run: str, calibration: str, document: str = "{}") -> None:
    store.save_run(make_run(run, "ready", None, calibration)).result(10)
    store.checks.save(run, calibration, document).result(10)


def test_the_first_and_the_latest_checks_are_kept(
    store: Store, make_run: MakeRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "FIRST_KEPT", 2)
    monkeypatch.setattr(module, "LATEST_KEPT", 3)
    calibration = store.keep_document("calibration", '{"n": 1}', NOW)
    for number in range(8):
        save(store, make_run, f"r{number}", calibration, f'"{number}"')
    assert store.checks.documents(calibration, 50, 50) == ['"0"', '"1"', '"5"', '"6"', '"7"']
    assert store.checks.documents(calibration, 1, 2) == ['"0"', '"6"', '"7"']
    assert store.checks.count(calibration) == 5


def test_each_calibration_has_separate_checks(store: Store, make_run: MakeRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FIRST_KEPT", 0)
    monkeypatch.setattr(module, "LATEST_KEPT", 1)
    before, after = (store.keep_document("calibration", f'{{"n": {n}}}', NOW) for n in (1, 2))
    save(store, make_run, "r1", before, '"before"')
    for run in ("r2", "r3"):
        save(store, make_run, run, after, f'"{run}"')
    assert store.checks.documents(before, 9, 9) == ['"before"']
    assert store.checks.documents(after, 9, 9) == ['"r3"']


def test_first_and_latest_overlap_without_duplicates(store: Store, make_run: MakeRun) -> None:
    calibration = store.keep_document("calibration", '{"n": 1}', NOW)
    for run in ("r1", "r2", "r3"):
        save(store, make_run, run, calibration, f'"{run}"')
    assert store.checks.documents(calibration, 2, 2) == ['"r1"', '"r2"', '"r3"']
    assert store.checks.documents(calibration, 0, 1) == ['"r3"']
    assert store.checks.documents(calibration, 0, 0) == []


def test_a_second_check_of_a_run_replaces_the_first(store: Store, make_run: MakeRun) -> None:
    calibration = store.keep_document("calibration", '{"n": 1}', NOW)
    save(store, make_run, "r1", calibration, '"old"')
    store.checks.save("r1", calibration, '"new"').result(10)
    assert store.checks.documents(calibration, 9, 9) == ['"new"']
    assert store.checks.count(calibration) == 1


def test_an_unknown_calibration_has_no_checks(checks: CalibrationChecks) -> None:
    assert checks.documents("0000", 9, 9) == []
    assert checks.count("0000") == 0


def test_a_check_of_a_run_that_does_not_exist_is_refused(store: Store) -> None:
    calibration = store.keep_document("calibration", '{"n": 1}', NOW)
    with pytest.raises(InternalError, match="FOREIGN KEY"):
        store.checks.save("r9", calibration, "{}").result(10)


@settings(max_examples=15, deadline=None)
@given(
    total=st.integers(0, 7),
    kept=st.tuples(st.integers(0, 3), st.integers(1, 3)),
    asked=st.tuples(st.integers(0, 4), st.integers(0, 4)),
)
def test_documents_are_those_of_a_plain_list(
    tmp_path_factory: pytest.TempPathFactory, total: int, kept: tuple[int, int], asked: tuple[int, int]
) -> None:
    """The reference: a list that is thinned after every save."""
    database = Database(tmp_path_factory.mktemp("checks") / "station.db")
    store = Store(database)
    calibration = store.keep_document("calibration", "{}", NOW)
    board_type = store.keep_document("board-type", "{}", NOW)
    expected: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "FIRST_KEPT", kept[0])
        patch.setattr(module, "LATEST_KEPT", kept[1])
        for number in range(total):
            run = f"r{number}"
            store.save_run(RunRow(run, "ready", None, board_type, calibration, "{}", "{}"))
            store.checks.save(run, calibration, run).result(10)
            expected = list(dict.fromkeys([*expected, run][: kept[0]] + [*expected, run][-kept[1] :]))
    latest = expected[-asked[1] :] if asked[1] else []
    found = store.checks.documents(calibration, *asked)
    database.close()
    assert found == sorted({*expected[: asked[0]], *latest})
