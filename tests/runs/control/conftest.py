"""An inbox whose thread runs, as the coordinator has it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from vaoi_station.runs.control.inbox import Inbox


@pytest.fixture
def inbox() -> Iterator[Inbox]:
    made = Inbox(lambda: None)
    made.start()
    yield made
    made.close()
