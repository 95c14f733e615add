"""Documents that a restart takes up again."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.store import Database, Store


def test_a_document_is_replaced_deleted_and_found_after_a_restart(path: Path) -> None:
    store = Store(Database(path))
    assert store.standing.get("armed") is None
    for document in ("1", "2"):
        store.standing.set("armed", document).result(10)
    store.standing.set("other", "x").result(10)
    store.standing.set("other", None).result(10)
    store.close()
    again = Store(Database(path))
    assert (again.standing.get("armed"), again.standing.get("other")) == ("2", None)
    again.close()
