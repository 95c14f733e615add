"""References and methods of board types survive restarts."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest

from vaoi_station.errors import StateError
from vaoi_station.store import Database, Store, schema
from vaoi_station.store.board_stitching import BoardStitching


@pytest.fixture
def stitching(store: Store) -> BoardStitching:
    return store.stitching


@pytest.fixture
def old_store(path: Path) -> Iterator[Store]:
    """A store over a database that was created before there were references and methods."""
    path.parent.mkdir(parents=True)
    old = sqlite3.connect(path, isolation_level=None)
    for statement in schema.STEPS[0]:
        old.execute(statement)
    old.execute("PRAGMA user_version = 1")
    old.close()
    store = Store(Database(path))
    yield store
    store.close()


def test_a_board_type_has_neither_reference_nor_method_at_first(stitching: BoardStitching) -> None:
    assert stitching.reference("a") is None
    assert stitching.method("a") is None
    assert stitching.references() == []


def test_a_new_reference_replaces_the_old_one_of_its_board_type_only(stitching: BoardStitching) -> None:
    stitching.keep_reference("a", "first").result(10)
    stitching.keep_reference("b", "other").result(10)
    stitching.keep_reference("a", "second").result(10)
    assert stitching.reference("a") == "second"
    assert stitching.reference("b") == "other"
    assert sorted(stitching.references()) == ["other", "second"]


def test_deleting_a_reference_keeps_the_method(stitching: BoardStitching) -> None:
    stitching.keep_reference("a", "document").result(10)
    stitching.keep_method("a", "features").result(10)
    stitching.drop_reference("a").result(10)
    assert stitching.reference("a") is None
    assert stitching.method("a") == "features"


def test_deleting_what_does_not_exist_has_no_effect(stitching: BoardStitching) -> None:
    stitching.keep_method("a", "auto").result(10)
    stitching.drop_reference("never").result(10)
    stitching.drop_method("never").result(10)
    assert stitching.method("a") == "auto"


@pytest.mark.parametrize("name", ["'; DROP TABLE board_methods; --", "größer", "a/b", " "])
def test_any_name_is_stored_as_it_is(stitching: BoardStitching, name: str) -> None:
    stitching.keep_method(name, "fiducials").result(10)
    assert stitching.method(name) == "fiducials"
    stitching.drop_method(name).result(10)
    assert stitching.method(name) is None


def test_settings_survive_a_restart(path: Path) -> None:
    store = Store(Database(path))
    store.stitching.keep_reference("a", "document")
    store.stitching.keep_method("a", "features")
    store.stitching.keep_method("a", "reference")
    store.close()
    store = Store(Database(path))
    assert store.stitching.references() == ["document"]
    assert store.stitching.method("a") == "reference"
    store.close()


def test_an_old_database_has_no_settings_and_accepts_them(old_store: Store) -> None:
    assert (old_store.stitching.reference("a"), old_store.stitching.method("a")) == (None, None)
    old_store.stitching.keep_method("a", "features").result(10)
    assert old_store.stitching.method("a") == "features"


def test_a_closed_store_refuses_settings(store: Store) -> None:
    store.close()
    with pytest.raises(StateError, match="is closed"):
        store.stitching.keep_reference("a", "document")
