"""A stream is cut into the same messages however its packets are cut, and never kept beyond the longest message."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.hermes.framing import Framing
from vaoi_station.hermes.messages import MOST_BYTES, Message, ProtocolError

MESSAGES = [
    Message.of("CheckAlive", Type=1, Id="7").to_bytes(),
    Message.of("MachineReady", FailedBoard=0).to_bytes(),
    b"<Hermes Timestamp='x'>\n <RevokeMachineReady/>\n</Hermes  >",
]


@given(
    st.lists(st.sampled_from(MESSAGES), max_size=6),
    st.lists(st.integers(0, 600), max_size=12),
    st.sampled_from([b"", b"\r\n", b" ", b'<?xml version="1.0"?>\n']),
)
def test_cuts_and_spaces_change_nothing(messages: list[bytes], cuts: list[int], between: bytes) -> None:
    stream, framing = b"".join(between + message for message in messages), Framing()
    places = [0, *sorted(cut for cut in cuts if cut < len(stream)), len(stream)]
    found = [one for a, b in itertools.pairwise(places) for one in framing.feed(stream[a:b])]
    assert found == messages


def test_the_longest_message_is_taken_byte_by_byte() -> None:
    head, tail = b'<Hermes><CheckAlive Id="', b'"/></Hermes>'
    message = head + b"x" * (MOST_BYTES - len(head) - len(tail)) + tail
    framing = Framing()
    found = [one for k in range(len(message)) for one in framing.feed(message[k : k + 1])]
    assert found == [message]


@pytest.mark.parametrize(
    "data", [b"<Hermes>" + b"x" * MOST_BYTES, b"\0" * (MOST_BYTES + 1), b"<Hermes>" + b"x" * MOST_BYTES + b"</Hermes>"]
)
def test_more_than_the_longest_message_is_refused(data: bytes) -> None:
    with pytest.raises(ProtocolError, match=r"65536"):
        Framing().feed(data)


def test_a_gigabyte_ends_with_its_first_64_kilobytes() -> None:
    framing, piece, fed = Framing(), b"<Hermes>" + b"y" * 4088, 0

    def feed() -> None:
        nonlocal fed
        while fed < 1 << 30:
            framing.feed(piece)
            fed += len(piece)

    with pytest.raises(ProtocolError):
        feed()
    assert fed <= MOST_BYTES


def test_a_document_type_before_a_message_is_refused() -> None:
    with pytest.raises(ProtocolError, match="document type"):
        Framing().feed(b'<!DOCTYPE a [<!ENTITY lol "lol">]><Hermes><CheckAlive/></Hermes>')
