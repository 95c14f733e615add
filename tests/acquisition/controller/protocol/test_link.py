"""The link without a device: what it sends, when it repeats, and what it reports of each reply."""

from __future__ import annotations

from dataclasses import replace

import pytest

from vaoi_station.acquisition.controller.interface import Permit
from vaoi_station.acquisition.controller.protocol import (
    HEARTBEAT_S,
    MAX_TRIES,
    REPLY,
    RETRY_S,
    Event,
    EventReceived,
    EventsLost,
    FrameReader,
    Kind,
    Link,
    Message,
    Nak,
    Notification,
    Reason,
    Refused,
    Replied,
    Request,
    Restarted,
    Status,
    Type,
    Unanswered,
    encode,
    number_request,
    ready,
)

STATUS = Status.unpack(bytes(44))
PING = number_request(Type.CLOCK, 7)


def sent(link: Link, now_s: float) -> Message | None:
    """The message that the link sends now."""
    messages = FrameReader().feed(link.outgoing(now_s))
    return messages[0] if messages else None


def reply(link: Link, payload: bytes, now_s: float = 0.0) -> list[Notification]:
    """Send the next request and reply to it."""
    request = sent(link, now_s)
    assert request is not None
    return link.receive(encode(Message(request.type | REPLY, request.sequence, payload)), now_s)


def event(number: int, boots: int) -> bytes:
    return encode(Message(Type.EVENT, boots % 256, Event(number, 0, Kind.PULSE, 1, number, 0).pack()))


def known(boots: int = 1, events: int = 0) -> Link:
    """A link that knows the boot."""
    link = Link()
    link.request(Request(Type.STATUS))
    reply(link, replace(STATUS, boots=boots, events_next=events).pack())
    return link


def test_one_request_is_under_way_at_a_time() -> None:
    link = Link()
    link.request(PING)
    link.request(Request(Type.SAFE))
    first = sent(link, 0.0)
    assert first is not None
    assert first.type == Type.CLOCK
    assert sent(link, RETRY_S / 2) is None
    link.receive(encode(Message(first.type | REPLY, first.sequence, bytes(8))), 0.01)
    second = sent(link, 0.02)
    assert second is not None
    assert (second.type, second.sequence) == (Type.SAFE, first.sequence + 1)


def test_a_request_is_repeated_with_the_same_sequence_number_and_then_given_up() -> None:
    link = Link(first_sequence=250)
    link.request(PING)
    messages = [sent(link, 1.1 * k * RETRY_S) for k in range(MAX_TRIES)]
    assert {m.sequence for m in messages if m} == {250}
    assert None not in messages
    assert link.retries == MAX_TRIES - 1
    assert link.receive(b"", 1.1 * (MAX_TRIES - 0.5) * RETRY_S) == []
    assert link.receive(b"", 1.1 * MAX_TRIES * RETRY_S) == [Unanswered(PING)]
    assert sent(link, 99.0) is None


def test_a_reply_is_dated_from_the_first_transmission() -> None:
    link = Link()
    link.request(PING)
    sent(link, 1.0)
    (replied,) = reply(link, bytes(8), 1.2)
    assert replied == Replied(PING, bytes(8), 1.0, 1.2)


@pytest.mark.parametrize(
    "message", [Message(Type.CLOCK | REPLY, 9, bytes(8)), Message(Type.SAFE | REPLY, 0), Message(Type.NAK, 5, bytes(8))]
)
def test_replies_to_other_requests_are_counted_and_ignored(message: Message) -> None:
    link = Link()
    link.request(PING)
    sent(link, 0.0)
    assert link.receive(encode(message), 0.0) == []
    assert link.unmatched == 1
    assert sent(link, RETRY_S) is not None, "the request is still pending"


def test_a_refusal_reaches_the_caller() -> None:
    link = Link()
    link.request(PING)
    request = sent(link, 0.0)
    assert request is not None
    nak = Nak(Type.CLOCK, Reason.STATE, 0, 1)
    assert link.receive(encode(Message(Type.NAK, request.sequence, nak.pack())), 0.0) == [Refused(PING, nak)]


def test_a_reply_of_impossible_size_leaves_the_request_pending() -> None:
    link = Link()
    link.request(Request(Type.STATUS))
    assert reply(link, b"short") == []
    assert link.unmatched == 1
    assert sent(link, RETRY_S) is not None


def test_the_heartbeat_goes_before_requests_and_keeps_its_interval() -> None:
    link = Link(heartbeat=True)
    link.request(PING)
    types = []
    for k in range(100):
        if message := sent(link, k * 0.01):
            types.append(message.type)
            link.receive(encode(Message(message.type | REPLY, message.sequence, STATUS.pack()[:44])), k * 0.01)
    assert types[:2] == [Type.BEAT, Type.CLOCK]
    assert types.count(Type.BEAT) == round(1.0 / HEARTBEAT_S)


def test_a_queued_request_is_sent_after_an_unanswered_heartbeat() -> None:
    """A heartbeat is given up after more than its interval, so the next one is due already."""
    link = Link(heartbeat=True)
    link.request(PING)
    sent_types: list[int] = []
    unanswered: list[Notification] = []
    for k in range(1000):
        if message := sent(link, k * 0.01):
            sent_types.append(message.type)
        unanswered += link.receive(b"", k * 0.01)
    assert sent_types[: 2 * MAX_TRIES + 1] == [Type.BEAT] * MAX_TRIES + [Type.CLOCK] * MAX_TRIES + [Type.BEAT]
    assert unanswered[:3] == [Unanswered(Request(Type.BEAT)), Unanswered(PING), Unanswered(Request(Type.BEAT))]


@pytest.mark.parametrize("kind", [Type.STATUS, Type.READ_EVENT])
def test_a_queued_request_is_sent_after_an_unanswered_request_of_the_link(kind: Type) -> None:
    link = known(events=0 if kind == Type.STATUS else 1)
    if kind == Type.STATUS:
        link.receive(event(0, boots=2), 0.0)
    link.request(PING)
    sent_types: list[int] = []
    unanswered: list[Notification] = []
    for k in range(250):
        if message := sent(link, k * 0.01):
            sent_types.append(message.type)
        unanswered += link.receive(b"", k * 0.01)
    assert sent_types[: 2 * MAX_TRIES] == [kind] * MAX_TRIES + [Type.CLOCK] * MAX_TRIES
    assert unanswered[1] == Unanswered(PING)


def test_after_a_reply_the_heartbeat_goes_first_again() -> None:
    link = Link(heartbeat=True)
    for k in range(MAX_TRIES + 1):
        sent(link, 1.1 * k * RETRY_S)
        link.receive(b"", 1.1 * k * RETRY_S)
    beat = sent(link, 2.0)
    assert beat is not None
    assert beat.type == Type.BEAT
    link.receive(encode(Message(beat.type | REPLY, beat.sequence, STATUS.pack())), 2.0)
    link.request(PING)
    following = sent(link, 2.0 + HEARTBEAT_S)
    assert following is not None
    assert following.type == Type.BEAT


def test_an_event_of_another_boot_is_not_passed_on_until_the_boot_is_known() -> None:
    link = known(boots=1)
    assert link.receive(event(0, boots=2), 0.0) == []
    assert not link.up_to_date
    restarted = reply(link, replace(STATUS, boots=2, events_next=1).pack())
    assert restarted == [Restarted(2)]
    read = sent(link, 0.0)
    assert read is not None
    assert (read.type, read.payload) == (Type.READ_EVENT, bytes(4))


def test_a_reset_returns_queued_requests_as_unanswered() -> None:
    link = known(boots=1)
    link.request(Request(Type.STATUS))
    link.request(PING)
    notifications = reply(link, replace(STATUS, boots=2).pack())
    assert notifications[:2] == [Restarted(2), Unanswered(PING)]
    assert isinstance(notifications[2], Replied)


def test_events_are_acknowledged_when_nothing_else_is_to_be_done() -> None:
    link = known()
    (received,) = link.receive(event(0, boots=1), 0.0)
    assert isinstance(received, EventReceived)
    assert link.status_is_outdated
    link.request(PING)
    assert reply(link, bytes(8))
    acknowledgement = sent(link, 0.0)
    assert acknowledgement is not None
    assert (acknowledgement.type, acknowledgement.payload) == (Type.ACK_EVENTS, bytes([1, 0, 0, 0]))


def test_events_that_the_controller_has_overwritten_are_reported_as_lost() -> None:
    link = known(events=5)
    request = sent(link, 0.0)
    assert request is not None
    assert request.type == Type.READ_EVENT
    nak = Nak(Type.READ_EVENT, Reason.GONE, 0, 3)
    assert link.receive(encode(Message(Type.NAK, request.sequence, nak.pack())), 0.0) == [EventsLost(3)]
    assert not link.up_to_date, "3 and 4 can still be read"


def test_events_of_an_earlier_process_are_skipped() -> None:
    link = known(events=5)
    link.skip_history()
    assert link.up_to_date
    (received,) = link.receive(event(5, boots=1), 0.0)
    assert isinstance(received, EventReceived)


def test_dropped_requests_are_neither_sent_nor_reported() -> None:
    link = Link()
    link.request(PING)
    sent(link, 0.0)
    link.request(PING)
    link.drop_requests()
    assert sent(link, 1.0) is None
    assert link.receive(b"", 99.0) == []


def test_damaged_bytes_are_counted() -> None:
    link = Link()
    link.receive(b"noise\0" + encode(Message(1, 1)), 0.0)
    assert (link.bad_frames, link.messages) == (1, 1)


def permitting(until_s: float = 10.0) -> Link:
    """A link to a controller with an interlock, with a permit that has not been sent."""
    link = known()
    link.ready_longest_ms, link.permit = 1000, Permit(5, until_s)
    return link


def stated(link: Link, now_s: float) -> bytes | None:
    """The payload of the READY that the link sends now, replied to; None if it sends no READY."""
    request = sent(link, now_s)
    if request is None:
        return None
    assert request.type == Type.READY
    link.receive(encode(Message(Type.READY | REPLY, request.sequence, replace(STATUS, boots=1).pack())), now_s)
    return request.payload


def test_a_permit_is_sent_at_once_renewed_and_withdrawn_at_once() -> None:
    link = permitting()
    assert stated(link, 0.0) == ready(5, 1000).payload
    assert stated(link, 0.9 * HEARTBEAT_S) is None
    assert stated(link, HEARTBEAT_S) == ready(5, 1000).payload
    link.permit = None
    assert stated(link, HEARTBEAT_S + 0.01) == ready(5, 0).payload
    assert stated(link, 5.0) is None, "withdrawn once"


def test_a_permit_is_never_stated_for_longer_than_it_is_valid() -> None:
    link = permitting(until_s=0.6)
    assert stated(link, 0.0) == ready(5, 600).payload
    assert stated(link, HEARTBEAT_S) == ready(5, 350).payload
    assert stated(link, 0.6) == ready(5, 0).payload
    assert stated(link, 1.0) is None


def test_a_repeated_ready_states_what_is_valid_when_it_is_repeated() -> None:
    """A late reply to the first transmission does not confirm the second."""
    link = permitting(until_s=0.5)
    first = sent(link, 0.0)
    link.permit = None
    again = sent(link, RETRY_S)
    assert first is not None
    assert again is not None
    assert (first.payload, again.payload) == (ready(5, 500).payload, ready(5, 0).payload)
    link.receive(encode(Message(Type.READY | REPLY, first.sequence, replace(STATUS, boots=1).pack())), RETRY_S)
    assert sent(link, 2 * RETRY_S) is not None, "still without a reply"


def test_ready_is_not_sent_to_a_controller_without_an_interlock() -> None:
    link = permitting()
    link.ready_longest_ms = 0
    assert sent(link, 0.0) is None


def test_a_permit_is_stated_anew_after_a_reset_of_the_controller() -> None:
    link = permitting()
    stated(link, 0.0)
    link.request(Request(Type.STATUS))
    reply(link, replace(STATUS, boots=2).pack(), 0.01)
    assert stated(link, 0.02) == ready(5, 1000).payload
