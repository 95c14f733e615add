"""Events are published in order, at least once, over restarts; failures are tried again and reported."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.push.event_list import EventList
from vaoi_station.push import publisher as module
from vaoi_station.push.broker import Broker, Outcome
from vaoi_station.push.publisher import Publisher, PublisherState, is_wanted, read_state
from vaoi_station.runs.states.schemas import EventRecord

WAIT_S = 30.0
FAILED = Outcome(False, "no reply.")
OK = Outcome(True, "acknowledged")


class Scripted(Broker):
    """A broker that keeps what it was given, and gives the scripted outcomes; after the last one it accepts all."""

    what, code = "MQTT broker", "mqtt-lost"

    def __init__(self, *outcomes: Outcome | Exception) -> None:
        self.outcomes, self.sent = list(outcomes), list[int]()
        self.closed, self._changed = False, threading.Condition()

    def send(self, record: EventRecord) -> Outcome:
        with self._changed:
            self.sent.append(record.number)
            self._changed.notify_all()
        outcome = self.outcomes.pop(0) if self.outcomes else OK
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def idle(self) -> Outcome | None:
        return None

    def close(self) -> None:
        self.closed = True

    def numbers(self, count: int) -> list[int]:
        """Wait until `count` events were sent; return their numbers."""
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.sent) >= count, WAIT_S)
            return list(self.sent)


def until(condition: Callable[[], object]) -> None:
    """Wait for what another thread changes."""
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline
        threading.Event().wait(0.005)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "push" / "mqtt.json"


@pytest.fixture
def running(events: EventList, path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Return a context manager that publishes the events to a broker."""
    monkeypatch.setattr(module, "PAUSES_S", (0.01, 0.02))

    @contextmanager
    def run(broker: Any, types: tuple[str, ...] = (), log: EventList | None = None) -> Iterator[Publisher]:
        chosen: Any = log or events
        broker.kinds = types
        made = Publisher("broker", path, chosen, broker)
        with made.running(lambda _: None):
            yield made
        assert not made.thread.is_alive()
        assert made.thread.fault() is None

    return run


def test_wanted_events_arrive_in_order_and_a_restart_goes_on(running: Any, events: EventList, path: Path) -> None:
    events.add("run", "before the first start")
    first, second = Scripted(), Scripted()
    with running(first, ("run",)) as publisher:
        for _ in range(3):
            events.add("run", "x", state="ready")
            events.add("camera", "not wanted")
        assert first.numbers(3) == [2, 4, 6]
        until(lambda: publisher.waiting == 0)
    assert first.closed
    events.add("run", "while the station was off")
    assert read_state(path, 99).last == 7
    with running(second, ("run",)):
        assert second.numbers(1) == [8]


def test_what_was_added_before_the_stop_is_published_at_the_stop(running: Any, events: EventList) -> None:
    broker = Scripted()
    with running(broker):
        for _ in range(60):
            events.add("station", "x", state="stopping")
    assert broker.sent == list(range(1, 61))
    assert broker.closed


def test_a_failed_event_is_tried_again_before_the_next(running: Any, events: EventList) -> None:
    broker = Scripted(FAILED, RuntimeError("a fault of the library"), FAILED, OK)
    with running(broker) as publisher:
        events.add("run", "a")
        until(publisher.reasons)
        (lost,) = publisher.reasons()
        assert lost.code == "mqtt-lost"
        assert lost.message.startswith("MQTT broker 'broker' does not accept messages: ")
        events.add("run", "b")
        first = [number for number in broker.numbers(5) if number]
        until(lambda: publisher.waiting == 0)
        assert (publisher.state.delivered, publisher.state.failures, publisher.reasons()) == (2, 3, ())
    assert first[:4] == [1, 1, 1, 1]
    assert [record.code for record in events.records if record.kind == "push"] == ["mqtt-lost", ""]
    # Events about the broker are not published.
    assert {record.kind for record in events.records if record.number in broker.sent} == {"run"}


def test_what_waits_too_long_is_skipped_and_said(
    running: Any, events: EventList, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST_WAITING", 4)
    with running(Scripted()):
        pass  # it has begun before number 1
    for number in range(10):
        events.add("run", str(number))
    broker = Scripted()
    with running(broker) as publisher:
        assert broker.numbers(2) == [9, 10]
        until(lambda: publisher.state.delivered == 2)
        assert publisher.state.skipped == 8
    [report] = [record for record in events.records if record.kind == "push"]
    assert report.code == "events-not-pushed"
    assert "8 events up to number 8" in report.message


@pytest.mark.parametrize("readable", [[], [120]])
def test_events_that_cannot_be_read_are_passed_over_and_said_once(
    running: Any, events: EventList, monkeypatch: pytest.MonkeyPatch, readable: list[int]
) -> None:
    with running(Scripted()):
        pass  # it has begun before number 1
    for number in range(120):
        events.add("run", str(number))
    read = events.read

    def some(after: int, timeout_s: float, limit: int) -> tuple[EventRecord, ...]:
        return tuple(e for e in read(after, timeout_s, limit) if e.number > 120 or e.number in readable)

    monkeypatch.setattr(events, "read", some)
    broker = Scripted()
    with running(broker, ("run",)) as publisher:
        until(lambda: events.last == 121)
        events.add("run", "new")
        assert broker.numbers(len(readable) + 1) == [*readable, 122]
        assert publisher.state.skipped == 120 - len(readable)
    [report] = [record for record in events.records if record.kind == "push"]
    assert "cannot read them" in report.message


@pytest.mark.parametrize(
    "content", [None, "", "{", '{"format": "vaoi-push-state", "version": 1, "last": -1}', '{"format": 1}']
)
def test_an_absent_or_damaged_state_begins_with_the_next_event(
    tmp_path: Path, content: str | None, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "mqtt.json"
    if content is not None:
        path.write_text(content)
    assert read_state(path, 40) == PublisherState(last=40)
    assert ("Publishing continues with the next event" in caplog.text) == (content is not None)


def event(**fields: Any) -> EventRecord:
    given = {"number": 7, "time": "2026-01-01T12:00:00.000Z", "kind": "run", "state": "ready", "run": "r1"} | fields
    return EventRecord(**given)


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
