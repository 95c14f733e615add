"""What runs told of their cameras: kept by calibration, the first and the latest."""

from __future__ import annotations

import pytest

from vaoi_station.store import RunRow, Store
from vaoi_station.store import calibration_checks as module


def a_run(store: Store, run: str, calibration: str) -> None:
    board_type = store.keep_document("board-type", "{}", "2026-01-01T00:00:00Z")
    store.save_run(RunRow(run, "ready", None, board_type, calibration, "{}", "{}")).result(10)


def test_the_first_and_the_latest_are_kept(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FIRST_KEPT", 2)
    monkeypatch.setattr(module, "LATEST_KEPT", 3)
    this = store.keep_document("calibration", '{"n": 1}', "2026-01-01T00:00:00Z")
    other = store.keep_document("calibration", '{"n": 2}', "2026-01-01T00:00:00Z")
    for number in range(8):
        a_run(store, f"r{number}", this)
        store.checks.save(f"r{number}", this, f'"{number}"').result(10)
    a_run(store, "r8", other)
    store.checks.save("r8", other, '"other"').result(10)
    assert store.checks.documents(this, 50, 50) == ['"0"', '"1"', '"5"', '"6"', '"7"']
    assert store.checks.documents(this, 1, 2) == ['"0"', '"6"', '"7"']
    assert store.checks.documents(other, 1, 1) == ['"other"']
    assert (store.checks.count(this), store.checks.count(other)) == (5, 1)
