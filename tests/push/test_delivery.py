"""A delivery is in order, at least once, over restarts; failures are tried again, given up and reported."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.push.event_list import EventList
from vaoi_station.errors import NotFoundError, StateError
from vaoi_station.push import delivery as module
from vaoi_station.push.delivery import Delivery, Rules
from vaoi_station.push.delivery_state import DeliveryState, read_state
from vaoi_station.push.messages import Message, message_of
from vaoi_station.push.push_service import WEBHOOK_WORDS
from vaoi_station.push.transport import Outcome
from vaoi_station.runs.states.schemas import EventRecord

WAIT_S = 30.0
FAILED = Outcome(False, "The receiver answers with status 500.")
OK = Outcome(True, "status 204")


class Scripted:
    """A transport that keeps what it was given, and gives the scripted outcomes; after the last one it accepts all."""

    def __init__(self, *outcomes: Outcome | Exception) -> None:
        self.outcomes, self.sent = list(outcomes), list[Message]()
        self.closed, self._changed = False, threading.Condition()

    def send(self, message: Message) -> Outcome:
        with self._changed:
            self.sent.append(message)
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
        """Wait until `count` messages were sent; return the numbers of their events."""
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.sent) >= count, WAIT_S)
            return [message.record.number for message in self.sent]


def until(condition: Callable[[], object]) -> None:
    """Wait for what another thread changes."""
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline
        threading.Event().wait(0.005)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "mes.json"


@pytest.fixture
def running(events: EventList, path: Path) -> Callable[..., Any]:
    """Return a context manager that runs a delivery with a transport and rules."""

    @contextmanager
    def run(transport: Scripted, types: tuple[str, ...] = (), **rules: Any) -> Iterator[Delivery]:
        made = Delivery("mes", path, events, "line-3", WEBHOOK_WORDS)
        made.set(transport, Rules(types, **{"pauses_s": (0.01, 0.02)} | rules))
        made.start()
        yield made
        made.stop()
        made.join(WAIT_S)
        assert not made.thread.is_alive()
        assert made.thread.fault() is None

    return run


def test_wanted_events_arrive_in_order_and_a_restart_goes_on(running: Any, events: EventList, path: Path) -> None:
    events.add("run", "before the webhook was made")
    first, second = Scripted(), Scripted()
    with running(first, ("run",)) as delivery:
        for _ in range(3):
            events.add("run", "x", state="ready")
            events.add("camera", "not wanted")
        assert first.numbers(3) == [2, 4, 6]
        until(lambda: delivery.waiting == 0)
    assert first.closed
    events.add("run", "while the station was off")
    assert read_state(path, lambda: 99).last == 7
    with running(second, ("run",)):
        assert second.numbers(1) == [8]


def test_a_failed_event_is_tried_again_before_the_next_with_the_same_id_and_bytes(
    running: Any, events: EventList
) -> None:
    transport = Scripted(FAILED, RuntimeError("a fault of the transport"), OK)
    with running(Scripted()):
        pass  # it has begun before number 1
    events.add("run", "a")
    events.add("run", "b")
    with running(transport) as delivery:
        assert transport.numbers(4)[:4] == [1, 1, 1, 2]
        until(lambda: delivery.state.delivered == 2)
        assert len({(message.id, message.body) for message in transport.sent[:3]}) == 1
        assert delivery.state.failures == 2
    kinds = [(record.kind, record.code) for record in events.records]
    assert kinds == [("run", ""), ("run", ""), ("push", "webhook-failing"), ("push", "")]
    assert transport.numbers(4) == [1, 1, 1, 2], "events about receivers are not pushed"


def test_an_event_becomes_a_dead_letter_after_the_schedule_and_the_next_follows(
    running: Any, events: EventList
) -> None:
    transport = Scripted(FAILED, FAILED, FAILED, OK, FAILED, OK)
    with running(Scripted()):
        pass  # it has begun before number 1
    events.add("run", "a")
    events.add("run", "b")
    with running(transport) as delivery:
        assert transport.numbers(4) == [1, 1, 1, 2]
        until(lambda: delivery.state.delivered == 1)
        [letter] = delivery.state.letters
        assert (letter.event.number, letter.attempts, letter.fault) == (1, 3, FAILED.detail)
        with pytest.raises(NotFoundError, match="has no dead letter of event 2; it has 1"):
            delivery.letter(2)
        assert not delivery.retry(1).result(WAIT_S).delivered
        assert len(delivery.state.letters) == 1
        assert delivery.retry(1).result(WAIT_S).delivered
        assert (delivery.state.letters, delivery.state.delivered) == ((), 2)
        assert transport.sent[0].id == transport.sent[-1].id
        with pytest.raises(NotFoundError):
            delivery.drop(1).result(WAIT_S)


def test_a_dead_letter_can_be_dropped(running: Any, events: EventList, path: Path) -> None:
    with running(Scripted(FAILED, FAILED, FAILED)) as delivery:
        events.add("run", "a")
        until(lambda: delivery.state.letters)
        delivery.drop(1).result(WAIT_S)
        assert delivery.state.letters == ()
    assert read_state(path, lambda: 99).letters == ()


def test_a_receiver_that_is_gone_is_disabled_until_it_is_enabled(running: Any, events: EventList) -> None:
    transport = Scripted(Outcome(False, "status 410", gone=True))
    with running(transport) as delivery:
        events.add("run", "a")
        until(lambda: delivery.state.disabled)
        warning = delivery.warning()
        assert warning is not None
        assert warning.code == "webhook-disabled"
        assert "wants no more messages (status 410)" in warning.message
        delivery.enable().result(WAIT_S)
        assert transport.numbers(2) == [1, 1]
        until(lambda: delivery.state.delivered == 1)
        assert delivery.warning() is None
    assert "webhook-disabled" in [record.code for record in events.records]


def test_a_long_failure_disables(running: Any, events: EventList, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "DISABLED_AFTER_S", 0.0)
    with running(Scripted(FAILED, FAILED)) as delivery:
        events.add("run", "a")
        until(lambda: delivery.state.disabled)
        assert "No delivery succeeded for 0.0 days" in delivery.state.disabled


def test_the_time_when_the_station_is_off_does_not_disable(
    running: Any, events: EventList, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(Scripted(FAILED), pauses_s=(3600.0,)) as delivery:
        events.add("run", "a")
        until(lambda: delivery.state.attempts)
    assert 0 < read_state(path, lambda: 99).failing_s < WAIT_S, "the sum is kept for the next start"
    later_s = time.time() + 10 * 86400
    monkeypatch.setattr(module, "time", SimpleNamespace(time=lambda: later_s, monotonic=time.monotonic))
    with running(Scripted(FAILED), pauses_s=(3600.0, 3600.0)) as delivery:
        until(lambda: delivery.state.attempts == 2)
        assert delivery.state.disabled == ""


def test_a_pause_goes_on_over_a_restart_and_a_clock_that_was_set_back_does_not_extend_it(
    running: Any, events: EventList, path: Path
) -> None:
    transport = Scripted(FAILED)
    with running(transport, pauses_s=(3600.0,)) as delivery:
        events.add("run", "a")
        until(lambda: delivery.state.attempts == 1)
        due_s = delivery.state.due_s
        assert 3590 < due_s - time.time() < 3970
    with running(transport, pauses_s=(3600.0,)) as delivery:
        assert delivery.state.due_s == due_s
        delivery.test(message_of(events.records[0], "x")).result(WAIT_S)  # a pass of the loop has ended
        assert len(transport.sent) == 2, "the test only"
    with running(transport, pauses_s=(0.01,)):
        assert transport.numbers(3) == [1, 1, 1]


def test_the_pause_that_a_receiver_asks_for_counts_up_to_the_longest(running: Any, events: EventList) -> None:
    with running(Scripted(Outcome(False, "429", retry_after_s=1e9)), pauses_s=(0.01, 3600.0)) as delivery:
        events.add("run", "a")
        until(lambda: delivery.state.attempts == 1)
        assert 3590 < delivery.state.due_s - time.time() < 3970


def test_what_waits_too_long_is_skipped_and_said(running: Any, events: EventList) -> None:
    for number in range(10):
        events.add("run", str(number))
    with running(Scripted()):
        pass  # it has begun after number 10
    for number in range(10):
        events.add("run", str(number))
    transport = Scripted()
    with running(transport, most_waiting=4) as delivery:
        assert transport.numbers(2) == [19, 20]
        until(lambda: delivery.state.delivered == 2)
        assert delivery.state.skipped == 8
    [report] = [record for record in events.records if record.kind == "push"]
    assert report.code == "events-not-pushed"
    assert "8 events up to number 18" in report.message


def test_a_gap_in_the_log_is_said(events: EventList, running: Any, path: Path) -> None:
    with running(Scripted()) as before:
        events.add("run", "a")
        until(lambda: before.waiting == 0)
    log = EventList(first=50)
    log.add("run", "the log has deleted what was before")
    delivery = Delivery("mes", path, log, "line-3", WEBHOOK_WORDS)
    transport = Scripted()
    delivery.set(transport, Rules((), (0.01,)))
    delivery.start()
    assert transport.numbers(1) == [50]
    delivery.stop()
    delivery.join(WAIT_S)
    assert delivery.state.skipped == 48


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
    transport = Scripted()
    with running(transport, ("run",)) as delivery:
        until(lambda: events.last == 121)
        events.add("run", "new")
        assert transport.numbers(len(readable) + 1) == [*readable, 122]
        assert delivery.state.skipped == 120 - len(readable)
    [report] = [record for record in events.records if record.kind == "push"]
    assert "cannot read them" in report.message


def test_a_disk_that_takes_no_writes_delays_nothing(
    running: Any, events: EventList, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path.mkdir()  # a state that cannot be written, nor read
    transport = Scripted()
    with running(transport):
        events.add("run", "a")
        events.add("run", "b")
        assert transport.numbers(2) == [1, 2]
    assert "is not a file and is not overwritten" in caplog.text


def test_a_full_disk_delays_nothing_and_ends_no_thread(
    running: Any, events: EventList, path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    transport = Scripted()
    with running(transport) as delivery:
        events.add("run", "a")
        assert transport.numbers(1) == [1]
        assert delivery.test(message_of(events.records[0], "x")).result(WAIT_S).delivered
    assert transport.closed
    assert not path.exists()
    assert "cannot be written (No space left on device)" in caplog.text
    with pytest.raises(StateError):
        delivery.enable().result(WAIT_S)


def test_a_request_whose_caller_has_gone_is_not_served_and_harms_no_other(events: EventList, path: Path) -> None:
    delivery = Delivery("mes", path, events, "line-3", WEBHOOK_WORDS)
    served: list[int] = []
    first, second = (delivery.submit(lambda: served.append(1)) for _ in range(2))
    assert first.cancel()
    delivery.start()
    second.result(WAIT_S)
    assert served == [1]
    delivery.stop()
    delivery.join(WAIT_S)
    stopped = Delivery("mes", path, events, "line-3", WEBHOOK_WORDS)
    first, second = (stopped.submit(lambda: served.append(2)) for _ in range(2))
    assert first.cancel()
    stopped.stop()
    stopped.start()
    with pytest.raises(StateError, match="was removed"):
        second.result(WAIT_S)
    stopped.join(WAIT_S)
    assert served == [1]


def test_requests_after_the_end_are_refused_and_a_removed_receiver_writes_nothing(
    events: EventList, path: Path
) -> None:
    delivery = Delivery("mes", path, events, "line-3", WEBHOOK_WORDS)
    delivery.set(Scripted(), Rules((), (0.01,)))
    delivery.start()
    events.add("run", "a")
    until(lambda: delivery.state.delivered == 1)
    delivery.stop(forget=True)
    delivery.join(WAIT_S)
    assert not path.exists()
    with pytest.raises(StateError, match="was removed"):
        delivery.enable().result(WAIT_S)
    assert not path.exists()


def test_the_state_is_one_that_is_not_changed_in_place() -> None:
    with pytest.raises(ValueError, match="frozen"):
        DeliveryState(last=1).last = 2  # type: ignore[misc]
