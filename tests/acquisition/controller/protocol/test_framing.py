"""Frames survive any content, any cut into pieces, and any neighbour."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.controller.protocol import (
    PAYLOAD_LONGEST,
    FrameReader,
    Message,
    cobs,
    crc16,
    decode,
    encode,
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


def test_a_payload_that_is_too_long_is_our_own_mistake() -> None:
    with pytest.raises(ValueError, match="58 is the longest"):
        encode(Message(1, 1, bytes(59)))
