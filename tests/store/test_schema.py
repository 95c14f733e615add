"""Migrations: step by step, whole or not at all."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from vaoi_station.store import schema


def test_an_old_database_is_brought_up_step_by_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    connection = sqlite3.connect(tmp_path / "x.db", isolation_level=None)
    schema.migrate(connection, tmp_path / "x.db")
    monkeypatch.setattr(schema, "STEPS", (*schema.STEPS, ("CREATE TABLE more (a INTEGER) STRICT",)))
    monkeypatch.setattr(schema, "VERSION", schema.VERSION + 1)
    schema.migrate(connection, tmp_path / "x.db")
    schema.migrate(connection, tmp_path / "x.db")
    assert connection.execute("PRAGMA user_version").fetchone() == (schema.VERSION,)
    assert connection.execute("SELECT count(*) FROM more").fetchone() == (0,)
    connection.close()


def test_a_step_that_fails_leaves_the_version_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    connection = sqlite3.connect(tmp_path / "x.db", isolation_level=None)
    good = schema.VERSION
    monkeypatch.setattr(schema, "STEPS", (*schema.STEPS, ("CREATE TABLE more (a INTEGER) STRICT", "NO SUCH WORD")))
    monkeypatch.setattr(schema, "VERSION", good + 1)
    with pytest.raises(sqlite3.OperationalError):
        schema.migrate(connection, tmp_path / "x.db")
    assert connection.execute("PRAGMA user_version").fetchone() == (good,)
    assert connection.execute("SELECT count(*) FROM sqlite_master WHERE name = 'more'").fetchone() == (0,)
    connection.close()
