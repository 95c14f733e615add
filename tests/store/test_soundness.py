"""Damage of the database is found while the station runs; a small file is checked before the start."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.store.conftest import MakeRun
from vaoi_station.errors import DeviceError
from vaoi_station.store import Database, EventRow, Store, database_file, soundness
from vaoi_station.store.soundness import DatabaseCheck


def a_round(check: DatabaseCheck) -> list[str]:
    """Let the check read everything once; return the faults that it found."""
    faults, before = [], check.rounds
    while check.rounds == before:
        try:
            check.step()
        except DeviceError as error:
            faults.append(f"{error.code}: {error.message}")
    return faults


@pytest.fixture
def filled(store: Store, make_run: MakeRun, monkeypatch: pytest.MonkeyPatch) -> Store:
    monkeypatch.setattr(soundness, "PAUSE_STEPS", 0)
    for n in range(60):
        store.save_run(make_run(f"r{n:02d}", "ready", n + 1), '{"t": 1}', f'{{"m": "{"x" * 20_000}"}}').result(10)
    for n in range(1, 500):
        store.add_event(EventRow(n, '{"e": 1}'))
    store.database.write(lambda _: None).result(10)
    return store


def test_a_sound_database_has_no_faults(filled: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    check = DatabaseCheck(filled.database)
    assert a_round(check) == []
    monkeypatch.setattr(soundness, "PAUSE_STEPS", 3)
    assert a_round(check) == []
    for _ in range(3):
        check.step()
    assert a_round(check) == [], "a pause lies between two rounds"
    filled.retention.forget_details(["r00"]).result(10)
    monkeypatch.setattr(soundness, "PAUSE_STEPS", 0)
    assert a_round(DatabaseCheck(filled.database)) == []


@pytest.mark.parametrize("table", ["results", "runs", "events"])
def test_garbled_pages_are_found_after_the_start(
    filled: Store, path: Path, monkeypatch: pytest.MonkeyPatch, table: str
) -> None:
    (root,) = filled.database.read("SELECT rootpage FROM sqlite_schema WHERE name = ?", (table,))[0]
    filled.database.close()
    content = bytearray(path.read_bytes())
    content[(root - 1) * 4096 : root * 4096] = b"\xa5" * 4096
    path.write_bytes(content)
    monkeypatch.setattr(database_file, "LARGEST_AT_START", 1000)
    database = Database(path)
    assert any(
        fault.startswith("database-damaged") and f"table {table}" in fault for fault in a_round(DatabaseCheck(database))
    )
    database.close()


@pytest.mark.parametrize("column", ["packed_detail", "packed_timeline"])
def test_a_damaged_packed_document_is_found(filled: Store, column: str) -> None:
    text = column.removeprefix("packed_")
    filled.database.write(
        lambda c: c.execute(f"UPDATE runs SET {text} = 'packed', {column} = x'78da00' WHERE id = 'r07'")
    ).result(10)
    (fault,) = a_round(DatabaseCheck(filled.database))
    assert "table runs has damaged rows (r07)" in fault


def test_a_damaged_document_is_found(filled: Store) -> None:
    filled.database.write(lambda c: c.execute("UPDATE runs SET timeline = '{' WHERE id = 'r07'")).result(10)
    (fault,) = a_round(DatabaseCheck(filled.database))
    assert "table runs has damaged rows (r07)" in fault
