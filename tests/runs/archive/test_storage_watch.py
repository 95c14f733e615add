"""Troubles of the storage as warnings and events."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import pytest

from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.storage_watch import StorageWatch
from vaoi_station.store import StorageTrouble, Store


@dataclass
class Acknowledgements:
    acknowledged: frozenset[Path] = frozenset()
    trouble: StorageTrouble | None = None
    notices: tuple[StorageTrouble, ...] = ()
    free_bytes: int | None = None

    def acknowledge(self, name: str) -> None:
        self.acknowledged |= {Path(name)}


class Sizes:
    def used_bytes(self) -> int:
        return 4096


@dataclass
class Storage:
    retention: Sizes = field(default_factory=Sizes)
    database: Acknowledgements = field(default_factory=Acknowledgements)


@dataclass
class Events:
    codes: list[str] = field(default_factory=list)

    def add(self, _kind: str, _message: str, *, code: str = "", action: str = "") -> None:
        self.codes.append(code)


@pytest.fixture
def storage() -> Storage:
    return Storage()


@pytest.fixture
def events() -> Events:
    return Events()


@pytest.fixture
def watch(storage: Any, events: Any) -> StorageWatch:
    return StorageWatch(cast("Store", storage), cast("EventLog", events), lambda: 3)


def test_a_trouble_is_published_once_and_is_a_warning_while_it_lasts(
    watch: StorageWatch, storage: Storage, events: Events
) -> None:
    watch.tick()
    assert (watch.warnings(), events.codes, watch.in_trouble) == ((), [], False)
    storage.database.trouble = StorageTrouble("storage-full", "The disk is full.", "Free space.")
    for _ in range(3):
        watch.tick()
    [warning] = watch.warnings()
    assert (warning.code, warning.message) == ("storage-full", "The disk is full. 3 finished runs wait in memory.")
    assert (events.codes, watch.in_trouble) == (["storage-full"], True)
    storage.database.trouble = None
    watch.tick()
    assert (watch.warnings(), events.codes) == ((), ["storage-full", "storage-back"])
