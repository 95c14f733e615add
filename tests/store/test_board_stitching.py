"""References and methods of board types, over restarts."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from vaoi_station.store import Database, Store, schema


def test_what_was_chosen_outlives_the_station(path: Path) -> None:
    store = Store(Database(path))
    store.stitching.keep_reference("a", "first").result()
    store.stitching.keep_reference("a", "second").result()
    store.stitching.keep_reference("b", "third").result()
    store.stitching.drop_reference("b").result()
    store.stitching.drop_reference("never").result()
    store.stitching.keep_method("a", "features").result()
    store.stitching.keep_method("a", "reference").result()
    store.close()
    store = Store(Database(path))
    assert (store.stitching.reference("a"), store.stitching.reference("b")) == ("second", None)
    assert store.stitching.references() == ["second"]
    assert store.stitching.method("a") == "reference"
    store.stitching.drop_method("a").result()
    assert store.stitching.method("a") is None
    store.close()


def test_a_database_of_before_has_neither(path: Path) -> None:
    path.parent.mkdir(parents=True)
    old = sqlite3.connect(path, isolation_level=None)
    for statement in schema.STEPS[0]:
        old.execute(statement)
    old.execute("PRAGMA user_version = 1")
    old.close()
    store = Store(Database(path))
    assert (store.stitching.reference("a"), store.stitching.method("a")) == (None, None)
    store.close()
