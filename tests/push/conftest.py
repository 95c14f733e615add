"""Deliveries that react at once."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.push.event_list import EventList
from tests.push.receiving import Receiver, receiver
from vaoi_station.push import delivery


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(delivery, "READ_S", 0.02)


@pytest.fixture
def events() -> EventList:
    return EventList()


@pytest.fixture
def target() -> Iterator[Receiver]:
    with receiver() as made:
        yield made
