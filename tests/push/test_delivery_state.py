"""The state of a receiver survives a restart, and is bounded."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.push.event_list import EventList
from vaoi_station.push.delivery_state import MOST_LETTERS, DeadLetter, DeliveryState, read_state, write_state


def letter(number: int) -> DeadLetter:
    event = EventList(number).add("run", "x")
    return DeadLetter(event=event, given_up="2026-01-01T12:00:00.000Z", attempts=10, fault="status 500")


def test_a_state_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "receivers" / "mes.json"
    state = DeliveryState(last=30).failed("status 500", failing_s=100.0, due_s=105.0).given_up(letter(31))
    write_state(path, state)
    assert read_state(path, lambda: 40) == state


def test_a_new_receiver_begins_with_the_next_event(tmp_path: Path) -> None:
    assert read_state(tmp_path / "none.json", lambda: 40) == DeliveryState(last=40)


@pytest.mark.parametrize(
    "content", ["", "{", '{"format": "vaoi-push-state", "version": 1, "last": -1}', '{"format": 1}']
)
def test_a_damaged_state_begins_with_the_next_event(
    tmp_path: Path, content: str, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "mes.json"
    path.write_text(content)
    assert read_state(path, lambda: 40) == DeliveryState(last=40)
    assert "Deliveries continue with the next event" in caplog.text


def test_a_shorter_log_begins_at_its_end(tmp_path: Path) -> None:
    """After a restored backup, or a power cut, the next events have numbers that were used before."""
    write_state(tmp_path / "mes.json", DeliveryState(last=30))
    state = read_state(tmp_path / "mes.json", lambda: 12)
    # The attempts were for the event 31, which no longer is the next one.
    assert (state.last, state.attempts, state.due_s) == (12, 0, 0.0)


def test_success_ends_a_failure_and_counts_only_messages() -> None:
    failed = DeliveryState(last=30).failed("status 500", 100.0, 105.0)
    assert (failed.failures, failed.attempts, failed.in_a_row, failed.failing_s) == (1, 1, 1, 100.0)
    done = failed.succeeded(31, "now")
    assert (done.last, done.delivered, done.attempts, done.in_a_row, done.failing_s) == (31, 1, 0, 0, 0.0)
    connected = failed.succeeded(None, "now")
    assert (connected.last, connected.delivered, connected.last_success, connected.fault) == (30, 0, None, "")


def test_dead_letters_are_bounded_and_dropped_by_number() -> None:
    state = DeliveryState(last=0)
    for number in range(1, MOST_LETTERS + 3):
        state = state.given_up(letter(number))
    assert (len(state.letters), state.letters_dropped, state.last) == (MOST_LETTERS, 2, MOST_LETTERS + 2)
    assert [e.event.number for e in state.without_letter(4).letters[:2]] == [3, 5]
