"""Pins over the life of a run."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest

from vaoi_station.errors import NotFoundError
from vaoi_station.store import Store


def test_a_pin_survives_a_restart_and_is_removed(make_rig: Callable[..., Any], store: Store) -> None:
    rig = make_rig()
    rig.ready()
    grant = rig.arm()
    rig.board(grant)
    rig.result_of(grant.run)
    kept = rig.coordinator.kept
    assert not kept.shown(rig.coordinator.run(grant.run)).pinned
    kept.pin(grant.run)
    again = Store(store.database)
    assert again.retention.pinned(grant.run)
    assert kept.all_shown(rig.coordinator.runs())[0].pinned
    kept.unpin(grant.run)
    assert not kept.shown(rig.coordinator.run(grant.run)).pinned
    with pytest.raises(NotFoundError, match="is not pinned") as refusal:
        kept.unpin(grant.run)
    assert refusal.value.code == "not-pinned"


def test_an_error_in_what_follows_a_run_prevents_neither_its_announcement_nor_the_rest(
    make_rig: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig()
    rig.ready()
    kept = rig.coordinator.kept

    def fail(*_: object) -> None:
        raise RuntimeError("a fault")

    monkeypatch.setattr(kept.trends, "finished", fail)
    reached = threading.Event()
    monkeypatch.setattr(kept.mosaics, "finished", lambda _: reached.set())
    grant = rig.arm()
    rig.board(grant)
    assert rig.result_of(grant.run).id == grant.run
    assert reached.wait(60), "the parts after the one that failed"
    announced = rig.coordinator.latest()
    while announced is None:
        announced = rig.coordinator.next_run(None, 0.1) or rig.coordinator.latest()
    assert announced.id == grant.run
    events = [event for event in rig.coordinator.events(0, 0.0) if event.code == "not-kept"]
    assert [event.message for event in events] == ["The trends of the run cannot be kept (RuntimeError: a fault)."]
