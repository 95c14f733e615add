"""Migrations are applied step by step, each in one transaction."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest

from vaoi_station.errors import InputError
from vaoi_station.store import schema

MORE = "CREATE TABLE more (a INTEGER) STRICT"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "x.db"


@pytest.fixture
def connection(path: Path) -> Iterator[sqlite3.Connection]:
    opened = sqlite3.connect(path, isolation_level=None)
    yield opened
    opened.close()


def version_of(connection: sqlite3.Connection) -> int:
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


def objects_in(connection: sqlite3.Connection) -> list[tuple[str, str]]:
    query = "SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY name"
    return [tuple(row) for row in connection.execute(query)]


def add_step(monkeypatch: pytest.MonkeyPatch, *statements: str) -> None:
    monkeypatch.setattr(schema, "STEPS", schema.STEPS | {schema.VERSION + 1: "".join(f"{s};\n" for s in statements)})
    monkeypatch.setattr(schema, "VERSION", schema.VERSION + 1)


def test_a_failed_step_keeps_the_previous_version(
    connection: sqlite3.Connection, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = schema.VERSION
    add_step(monkeypatch, MORE, "NO SUCH WORD")
    with pytest.raises(sqlite3.OperationalError):
        schema.migrate(connection, path)
    assert version_of(connection) == good
    assert "more" not in {name for name, _ in objects_in(connection)}


@pytest.mark.parametrize(("version", "code"), [(schema.VERSION + 1, "database-newer"), (12, "database-foreign")])
def test_a_database_of_an_unknown_version_is_refused_and_left_unchanged(
    connection: sqlite3.Connection, path: Path, version: int, code: str
) -> None:
    connection.execute(f"PRAGMA user_version = {version}")
    with pytest.raises(InputError, match=f"has version {version}") as refusal:
        schema.migrate(connection, path)
    assert refusal.value.code == code
    assert objects_in(connection) == []


def test_a_database_of_an_earlier_version_keeps_its_rows_and_gets_what_is_new(
    connection: sqlite3.Connection, path: Path
) -> None:
    connection.executescript(f"{schema.STEPS[13]} PRAGMA user_version = 13;")
    connection.execute("INSERT INTO standing VALUES ('k', '{}')")
    schema.migrate(connection, path)
    assert version_of(connection) == schema.VERSION
    assert connection.execute("SELECT document FROM standing").fetchall() == [("{}",)]
    assert connection.execute("SELECT count(*) FROM parts").fetchone() == (0,)


def test_a_packed_text_is_unpacked_exactly_and_a_short_one_stays_readable() -> None:
    long = json.dumps([{"x": n, "unit": "µm"} for n in range(200)])
    text, content = schema.packed(long)
    assert content is not None
    assert text == schema.PACKED
    assert len(content) < len(long) / 4
    assert schema.unpacked(text, content) == long
    assert schema.packed("{}") == ("{}", None)
    assert schema.unpacked(long, None) == long, "rows of earlier versions are not packed"
    with pytest.raises(sqlite3.DatabaseError, match="damaged"):
        schema.unpacked(text, content[:-1] + b"x")
