"""Messages have a stable, unique id, a type of the specification's form, and the event's document."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from vaoi_station.push.messages import is_wanted, message_of, type_of
from vaoi_station.runs.states.schemas import EventRecord


def event(**fields: Any) -> EventRecord:
    given = {"number": 7, "time": "2026-01-01T12:00:00.000Z", "kind": "run", "state": "ready", "run": "r1"} | fields
    return EventRecord(**given)


def test_a_message_has_type_timestamp_and_data() -> None:
    message = message_of(event(), "line-3")
    assert json.loads(message.body) == {
        "type": "run.ready",
        "timestamp": "2026-01-01T12:00:00.000Z",
        "data": {
            "station": "line-3", "number": 7, "time": "2026-01-01T12:00:00.000Z", "kind": "run", "state": "ready",
            "run": "r1", "code": "", "message": "", "action": "",
        },
    }  # fmt: skip
    assert re.fullmatch(r"evt_7_[0-9a-f]{16}", message.id)


def test_an_id_stays_and_is_given_once() -> None:
    """A power cut may take the newest events from the log, and others then get their numbers."""
    again = {message_of(event(), "a").id for _ in range(2)}
    others = {message_of(e, s).id for e, s in ((event(), "b"), (event(time="2026-01-01T12:00:01.000Z"), "a"))}
    assert len(again) == 1
    assert len(again | others) == 3


@pytest.mark.parametrize(
    ("types", "kind", "state", "wanted"),
    [
        ((), "trouble", "", True),
        (("run",), "run", "ready", True),
        (("run.ready",), "run", "ready", True),
        (("run.ready",), "run", "gone", False),
        (("run.ready",), "run", "", False),
        (("ru",), "run", "ready", False),
        (("board-missed",), "board-missed", "", True),
        (("station", "board_missed"), "board-missed", "", True),
        ((), "push", "", False),
        (("push",), "push", "", False),
    ],
)
def test_a_filter_names_kinds_or_kinds_with_states(types: tuple[str, ...], kind: str, state: str, wanted: bool) -> None:
    assert is_wanted(event(kind=kind, state=state), types) is wanted


def test_a_type_has_only_characters_that_the_specification_recommends() -> None:
    assert type_of(event(kind="board-missed", state="")) == "board_missed"
