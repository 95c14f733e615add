"""Structs survive packing, and requests carry what the protocol defines."""

from __future__ import annotations

import zlib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.hw.emulated.vectors import IDENT
from vaoi_station.acquisition.controller.protocol import (
    ClockReply,
    Event,
    Ident,
    Nak,
    Request,
    Status,
    Step,
    Timing,
    Type,
    arm,
    config_crc,
    configuration,
    fire_one,
    number_request,
    set_step,
)

U8, U16, U32 = st.integers(0, 0xFF), st.integers(0, 0xFFFF), st.integers(0, 0xFFFFFFFF)
TIMING = Timing(0, 2, 50, 40_000, 40_000, 60_000, 40_000, 4_000, 20_000, 200)
STEPS = (Step(1, 500), Step(6, 300))


@given(st.builds(Event, U32, U32, U8, U8, U16, U32))
def test_events_survive_packing(event: Event) -> None:
    assert Event.unpack(event.pack()) == event


@given(st.builds(Timing, U8, U8, U16, U32, U32, U32, U32, U32, U32, U16))
def test_timings_survive_packing(timing: Timing) -> None:
    assert Timing.unpack(timing.pack()) == timing


@pytest.mark.parametrize(
    ("kind", "size"), [(Timing, 30), (Step, 4), (Ident, 52), (Status, 48), (Event, 16), (ClockReply, 8), (Nak, 8)]
)
def test_sizes_are_those_of_the_protocol(kind: Any, size: int) -> None:
    """The firmware asserts the same numbers at compile time (protocol.h)."""
    assert len(kind.unpack(bytes(size)).pack()) == size
    too_few = (kind.OLDEST_BYTES or size) - 1
    with pytest.raises(ValueError, match=f"has {size} bytes, not {too_few}"):
        kind.unpack(bytes(too_few))


@pytest.mark.parametrize("kind", [Ident, Status])
def test_a_higher_minor_version_may_append_fields(kind: Any) -> None:
    size = kind.LAYOUT.size
    assert kind.unpack(bytes(size) + b"more") == kind.unpack(bytes(size))


@pytest.mark.parametrize(("kind", "size"), [(Ident, 48), (Status, 44)])
def test_fields_that_firmware_1_1_does_not_send_are_zero(kind: Any, size: int) -> None:
    old = kind.unpack(bytes(range(1, size + 1)))
    assert old.pack() == bytes(range(1, size + 1)) + bytes(kind.LAYOUT.size - size)


@pytest.mark.parametrize("kind", [Timing, Step, Event, ClockReply, Nak])
def test_other_structs_have_one_size(kind: Any) -> None:
    with pytest.raises(ValueError, match="bytes"):
        kind.unpack(bytes(kind.LAYOUT.size + 1))


def test_numbers_are_little_endian() -> None:
    assert number_request(Type.CLOCK, 0x01020304) == Request(Type.CLOCK, bytes([4, 3, 2, 1]))
    assert arm(0x0102, 0x03040506) == Request(Type.ARM, bytes([2, 1, 6, 5, 4, 3]))
    assert set_step(3, Step(5, 0x0102)) == Request(Type.STEP, bytes([3, 5, 0, 2, 1]))
    assert fire_one(0x0102, Step(5, 600), 200).payload == bytes([2, 1, 5, 0, 88, 2, 200, 0])


def test_the_checksum_is_that_of_zlib_over_what_is_sent() -> None:
    requests = configuration(TIMING, STEPS)
    sent = requests[0].payload + b"".join(r.payload[1:] for r in requests[1:-1])
    assert config_crc(TIMING, STEPS) == zlib.crc32(sent)


def test_a_configuration_is_committed_last_with_its_checksum() -> None:
    requests = configuration(TIMING, STEPS)
    assert [r.type for r in requests] == [Type.TIMING, Type.STEP, Type.STEP, Type.COMMIT]
    assert [r.payload[0] for r in requests[1:3]] == [0, 1]
    assert int.from_bytes(requests[-1].payload, "little") == config_crc(TIMING, STEPS)


def test_a_wrong_number_of_steps_is_refused() -> None:
    with pytest.raises(ValueError, match=r"timing\.steps is 2, but there are 1 steps"):
        configuration(TIMING, STEPS[:1])


def test_the_text_of_an_identity_is_padded_with_zeros() -> None:
    assert Ident.unpack(IDENT.pack()).board.rstrip(b"\0") == b"m328p16"
