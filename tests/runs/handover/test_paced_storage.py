"""Every access waits its turn, and is passed on."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.errors import NotFoundError, StateError
from vaoi_station.plant.storage import LocalStorage
from vaoi_station.runs.handover.paced_storage import PacedStorage


def test_every_access_waits_its_turn(tmp_path: Path) -> None:
    sizes: list[int] = []
    storage = PacedStorage(LocalStorage(tmp_path), sizes.append)
    storage.write("a/b", b"four")
    assert (storage.read("a/b"), storage.names("a"), storage.url) == (b"four", ["b"], str(tmp_path))
    assert [entry.key for entry in storage.entries("a")] == ["a/b"]
    assert list(storage.leftovers()) == []
    storage.delete("a/b")
    assert storage.entry("a/b") is None
    with pytest.raises(NotFoundError):
        storage.read("a/b")
    assert sizes == [4, 0, 0, 0, 0, 0, 0, 0]


def test_an_exception_ends_what_is_under_way(tmp_path: Path) -> None:
    def refuse(_: int) -> None:
        raise StateError("The station is stopping.")

    with pytest.raises(StateError):
        PacedStorage(LocalStorage(tmp_path), refuse).write("a", b"")
    assert list(tmp_path.iterdir()) == []
