"""The golden vectors of hw/protocol_vectors.json, read by both ends: the firmware's C and the station's Python."""

from __future__ import annotations

import ctypes
from typing import Any

import pytest

from tests.hw.emulated.vectors import VECTORS
from vaoi_station.acquisition.controller import protocol
from vaoi_station.acquisition.controller.protocol import (
    FrameReader,
    Message,
    Step,
    Timing,
    config_crc,
    configuration,
    encode,
)

FRAMES = pytest.mark.parametrize("vector", VECTORS["frames"], ids=lambda v: str(v["name"]))
NO_FRAMES = pytest.mark.parametrize("vector", VECTORS["no_frames"], ids=lambda v: str(v["name"]))
CONFIGURATIONS = pytest.mark.parametrize("vector", VECTORS["configurations"])
RECEIVER_BYTES = 128
"""More than sizeof(struct receiver)."""


def values(fields: dict[str, Any]) -> dict[str, Any]:
    return {key: value.encode().ljust(8, b"\0") if isinstance(value, str) else value for key, value in fields.items()}


def c_receive(logic: ctypes.CDLL, data: bytes) -> int:
    """How many messages the firmware takes from these bytes."""
    receiver = ctypes.create_string_buffer(RECEIVER_BYTES)
    return sum(logic.receive(receiver, ctypes.c_uint8(byte)) & 0xFF for byte in data)


@FRAMES
def test_python_frames(vector: dict[str, Any]) -> None:
    message = Message(vector["type"], vector["sequence"], bytes.fromhex(vector["payload"]))
    frame = bytes.fromhex(vector["frame"])
    assert encode(message) == frame
    assert FrameReader().feed(frame) == [message]
    if "struct" in vector:
        wire = getattr(protocol, vector["struct"])
        assert wire.unpack(message.payload) == wire(**values(vector["fields"]))
        assert wire(**values(vector["fields"])).pack() == message.payload


@FRAMES
def test_c_frames(logic: ctypes.CDLL, vector: dict[str, Any]) -> None:
    payload, frame = bytes.fromhex(vector["payload"]), bytes.fromhex(vector["frame"])
    made = ctypes.create_string_buffer(80)
    size = logic.make_frame(made, vector["type"], vector["sequence"], payload, len(payload)) & 0xFF
    assert made.raw[:size] == frame
    assert c_receive(logic, frame) == 1
    assert c_receive(logic, frame[:-2] + b"\0") == 0


@NO_FRAMES
def test_python_refuses(vector: dict[str, Any]) -> None:
    reader = FrameReader()
    assert reader.feed(bytes.fromhex(vector["bytes"])) == []
    assert reader.bad == vector["bad"]
    assert len(reader.feed(bytes.fromhex(VECTORS["frames"][0]["frame"]))) == 1


@NO_FRAMES
def test_c_refuses(logic: ctypes.CDLL, vector: dict[str, Any]) -> None:
    logic.bridge_start(0)
    replies = ctypes.create_string_buffer(1000)
    bad = bytes.fromhex(vector["bytes"])
    assert logic.bridge_talk(bad, len(bad), replies, 0) == 0
    assert logic.bridge_bad_frames() & 0xFFFF == vector["bad"]
    good = bytes.fromhex(VECTORS["frames"][0]["frame"])
    assert logic.bridge_talk(good, len(good), replies, 0) > 0


@CONFIGURATIONS
def test_checksum_of_a_configuration(logic: ctypes.CDLL, vector: dict[str, Any]) -> None:
    """Python counts it, and the firmware echoes it when it takes the configuration over."""
    timing, steps = Timing(**vector["timing"]), [Step(**step) for step in vector["steps"]]
    widths = vector.get("widths", [])
    assert config_crc(timing, steps, widths) == vector["crc32"]
    logic.bridge_start(0)
    sent = configuration(timing, steps, widths)
    requests = b"".join(encode(Message(r.type, k, r.payload)) for k, r in enumerate(sent))
    replies = ctypes.create_string_buffer(1000)
    size = logic.bridge_talk(requests, len(requests), replies, 0)
    *_, last = FrameReader().feed(replies.raw[:size])
    assert last == Message(0x87, len(sent) - 1, vector["crc32"].to_bytes(4, "little"))
