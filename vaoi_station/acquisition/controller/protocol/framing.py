"""Messages ↔ bytes: COBS(type, sequence, payload, CRC-16), then 0x00.

COBS is Cheshire and Baker, "Consistent Overhead Byte Stuffing", 1999: the content without zeros, so that a zero
ends a frame and nothing else does. The checksum is CRC-16/CCITT-FALSE, low byte first.
"""

from __future__ import annotations

import binascii
from dataclasses import dataclass

PAYLOAD_LONGEST = 58
_CONTENT_LONGEST = 2 + PAYLOAD_LONGEST + 2


@dataclass(frozen=True)
class Message:
    """One message of either side."""

    type: int
    sequence: int
    payload: bytes = b""


def encode(message: Message) -> bytes:
    """The frame of a message, delimiter included."""
    if len(message.payload) > PAYLOAD_LONGEST:
        raise ValueError(f"a payload of {len(message.payload)} bytes; {PAYLOAD_LONGEST} is the longest")
    content = bytes([message.type, message.sequence]) + message.payload
    return cobs(content + crc16(content).to_bytes(2, "little")) + b"\0"


def decode(frame: bytes) -> Message | None:
    """The message of a frame without its delimiter; None if it is none."""
    content = uncob(frame) if len(frame) <= _CONTENT_LONGEST + 1 else None
    if content is None or len(content) < 4 or crc16(content[:-2]) != int.from_bytes(content[-2:], "little"):
        return None
    return Message(content[0], content[1], content[2:-2])


class FrameReader:
    """Collects bytes as they come; after anything that is no frame it goes on behind the next zero."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self.bad = 0
        """Frames thrown away."""

    def feed(self, data: bytes) -> list[Message]:
        """The messages that these bytes complete."""
        self._bytes += data
        *frames, rest = self._bytes.split(b"\0")
        # What is too long already stays too long: enough of it is kept to be recognised by.
        self._bytes = rest[: _CONTENT_LONGEST + 2]
        messages = [(frame, decode(bytes(frame))) for frame in frames if frame]
        self.bad += sum(message is None for _, message in messages)
        return [message for _, message in messages if message is not None]


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF, nothing reflected."""
    return binascii.crc_hqx(data, 0xFFFF)


def cobs(content: bytes) -> bytes:
    """Content of at most 253 bytes without zeros."""
    return b"".join(bytes([len(part) + 1]) + part for part in content.split(b"\0"))


def uncob(frame: bytes) -> bytes | None:
    """The content of a frame; None if its codes lead out of it, or if there is a zero in it."""
    parts: list[bytes] = []
    at = 0
    while at < len(frame):
        end = at + frame[at]
        if frame[at] == 0 or end > len(frame):
            return None
        parts.append(frame[at + 1 : end])
        at = end
    return None if b"\0" in frame else b"\0".join(parts)
