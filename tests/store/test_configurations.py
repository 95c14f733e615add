"""Configurations are stored once and found by digest."""

from __future__ import annotations

import pytest

from vaoi_station.errors import NotFoundError
from vaoi_station.store import Database, Store


def test_a_configuration_is_stored_once(store: Store, database: Database) -> None:
    assert store.configurations.present == ""
    first = store.configurations.begin('{"a": 1}', "2026")
    assert store.configurations.begin('{"a": 1}', "2027") == first
    second = store.configurations.begin('{"a": 2}', "2028")
    assert store.configurations.present == second != first
    assert store.configurations.document(first) == '{"a": 1}'
    assert database.read("SELECT count(*) AS n, min(first_seen) AS s FROM configurations")[0]["n"] == 2
    database.write(lambda c: c.execute("DELETE FROM configurations")).result(10)
    store.configurations.store_again("2029")
    assert store.configurations.document(second) == '{"a": 2}'
    with pytest.raises(NotFoundError, match="no configuration 'x'"):
        store.configurations.document("x")
