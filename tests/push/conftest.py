"""An event log in memory, and a publisher that reacts at once."""

from __future__ import annotations

import pytest

from tests.push.event_list import EventList
from vaoi_station.push import publisher


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(publisher, "READ_S", 0.02)


@pytest.fixture
def events() -> EventList:
    return EventList()
