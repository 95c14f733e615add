"""The serial protocol: framing, messages, order of events, refusals, and the link."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.controller.interface import Permit
from vaoi_station.acquisition.controller.protocol import (
    HEARTBEAT_S,
    MAX_TRIES,
    PAYLOAD_LONGEST,
    REPLY,
    RETRY_S,
    Event,
    EventOrder,
    FrameReader,
    Ident,
    Kind,
    Link,
    Message,
    Nak,
    Notification,
    Reason,
    Request,
    Restarted,
    Status,
    Type,
    Unanswered,
    cobs,
    crc16,
    decode,
    describe,
    encode,
    number_request,
    ready,
    uncob,
)

MESSAGES = st.builds(
    Message,
    st.integers(0, 255),
    st.integers(0, 255),
    st.binary(max_size=PAYLOAD_LONGEST) | st.just(bytes(PAYLOAD_LONGEST)),
)


@given(st.binary(max_size=200))
def test_cobs_takes_out_zeros_and_puts_them_back(content: bytes) -> None:
    stuffed = cobs(content)
    assert b"\0" not in stuffed
    assert len(stuffed) == len(content) + 1
    assert uncob(stuffed) == content


@given(st.lists(MESSAGES, max_size=6), st.data())
def test_messages_come_out_as_they_went_in_however_they_are_cut(messages: list[Message], data: st.DataObject) -> None:
    stream = b"".join(encode(m) for m in messages)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    reader = FrameReader()
    pieces = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    assert [m for piece in pieces for m in reader.feed(piece)] == messages
    assert reader.bad == 0


@given(st.binary(max_size=400), MESSAGES)
def test_after_any_noise_the_next_frame_is_understood(noise: bytes, message: Message) -> None:
    reader = FrameReader()
    reader.feed(noise + b"\0")
    assert reader.feed(encode(message)) == [message]


@given(MESSAGES, st.data())
def test_up_to_two_wrong_bits_are_always_noticed(message: Message, data: st.DataObject) -> None:
    """Within the content, where the checksum stands for 65 bytes: the polynomial sees every pair of bits there."""
    content = bytes([message.type, message.sequence]) + message.payload
    content += crc16(content).to_bytes(2, "little")
    bits = data.draw(st.sets(st.integers(0, 8 * len(content) - 1), min_size=1, max_size=2))
    damaged = bytearray(content)
    for bit in bits:
        damaged[bit // 8] ^= 1 << bit % 8
    assert decode(cobs(bytes(damaged))) is None


@pytest.mark.parametrize("kind", [Ident, Status])
def test_a_higher_minor_version_may_append_fields(kind: Any) -> None:
    size = kind.LAYOUT.size
    assert kind.unpack(bytes(size) + b"more") == kind.unpack(bytes(size))


def event(number: int) -> Event:
    return Event(number, 10 * number, Kind.PULSE, 1, 0, 0)


def numbers(events: list[Event]) -> list[int]:
    return [e.number for e in events]


@given(st.lists(st.integers(0, 12), max_size=60))
def test_each_event_comes_out_once_and_in_order(arrivals: list[int]) -> None:
    order, passed = EventOrder(), list[int]()
    for number in arrivals:
        passed += numbers(order.add(event(number)))
    assert passed == list(range(len(passed)))
    first_gap = next(k for k in range(14) if k not in arrivals)
    assert len(passed) == first_gap == order.next_number


@pytest.mark.parametrize(
    ("nak", "words"),
    [
        (Nak(Type.COMMIT, Reason.RANGE, 4, 10000), "COMMIT was refused: period is out of range, .* 10000"),
        (Nak(Type.COMMIT, Reason.LED_LIMIT, 17, 2000), "step 1 asks more of the LEDs than their limit of 2000 ticks"),
        (Nak(Type.ARM, Reason.STATE, 0, 3), "ARM was refused: the controller is SAFE"),
        (Nak(Type.ARM, Reason.CHECKSUM, 0, 0xABC), "0x00000abc"),
        (Nak(Type.FIRE_ONE, Reason.LED_BUDGET, 2, 0), "channel 2 have not cooled down"),
        (Nak(0x3F, Reason.UNKNOWN, 0, 0), "request 0x3f was refused: this firmware does not know it"),
        (Nak(Type.CLOCK, 99, 0, 0), "CLOCK was refused: 99"),
    ],
)
def test_refusals_are_sentences(nak: Nak, words: str) -> None:
    assert re.search(words, describe(nak))


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


def link_event(number: int, boots: int) -> bytes:
    return encode(Message(Type.EVENT, boots % 256, Event(number, 0, Kind.PULSE, 1, number, 0).pack()))


def known(boots: int = 1, events: int = 0) -> Link:
    """A link that knows the boot."""
    link = Link()
    link.request(Request(Type.STATUS))
    reply(link, replace(STATUS, boots=boots, events_next=events).pack())
    return link


def test_a_request_is_repeated_with_the_same_sequence_number_and_then_given_up() -> None:
    link = Link()
    link.request(PING)
    messages = [sent(link, 1.1 * k * RETRY_S) for k in range(MAX_TRIES)]
    assert {m.sequence for m in messages if m} == {0}
    assert None not in messages
    assert link.retries == MAX_TRIES - 1
    assert link.receive(b"", 1.1 * (MAX_TRIES - 0.5) * RETRY_S) == []
    assert link.receive(b"", 1.1 * MAX_TRIES * RETRY_S) == [Unanswered(PING)]
    assert sent(link, 99.0) is None


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


def test_an_event_of_another_boot_is_not_passed_on_until_the_boot_is_known() -> None:
    link = known(boots=1)
    assert link.receive(link_event(0, boots=2), 0.0) == []
    assert not link.up_to_date
    restarted = reply(link, replace(STATUS, boots=2, events_next=1).pack())
    assert restarted == [Restarted(2)]
    read = sent(link, 0.0)
    assert read is not None
    assert (read.type, read.payload) == (Type.READ_EVENT, bytes(4))


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
