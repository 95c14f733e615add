"""Framing of messages: COBS(type, sequence, payload, CRC-16), then 0x00.

COBS is Cheshire and Baker, "Consistent Overhead Byte Stuffing", 1999. It removes all zeros from the content, so that a
zero always ends a frame. The checksum is CRC-16/CCITT-FALSE, low byte first.
"""

from __future__ import annotations

import binascii
from dataclasses import dataclass

PAYLOAD_LONGEST = 58
"""Longest payload, bytes; the firmware's buffers have this size (hw/firmware/logic/link/protocol.h)."""
_CONTENT_LONGEST = 2 + PAYLOAD_LONGEST + 2


@dataclass(frozen=True)
class Message:
    """One message of the host or of the controller: type, sequence number and content."""

    type: int
    sequence: int
    payload: bytes = b""


def encode(message: Message) -> bytes:
    """Return the frame of a message, including its delimiter; ValueError if the payload is too long."""
    if len(message.payload) > PAYLOAD_LONGEST:
        raise ValueError(f"a payload of {len(message.payload)} bytes; {PAYLOAD_LONGEST} is the longest")
    content = bytes([message.type, message.sequence]) + message.payload
    return cobs(content + crc16(content).to_bytes(2, "little")) + b"\0"


def decode(frame: bytes) -> Message | None:
    """Return the message in a frame without its delimiter; None if the frame is damaged."""
    # The length is checked first: the firmware has no longer frames, and noise may be of any length.
    content = uncob(frame) if len(frame) <= _CONTENT_LONGEST + 1 else None
    if content is None or len(content) < 4 or crc16(content[:-2]) != int.from_bytes(content[-2:], "little"):
        return None
    return Message(content[0], content[1], content[2:-2])


class FrameReader:
    """Reader that splits received bytes into messages. After a damaged frame it continues after the next zero byte."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self.bad = 0
        """Count of damaged frames that were received."""

    def feed(self, data: bytes) -> list[Message]:
        """Process received bytes, and return the messages that are complete with them."""
        self._bytes += data
        *frames, rest = self._bytes.split(b"\0")
        # Noise without zeros must not fill the memory. The part that is kept is still too long for a frame.
        self._bytes = rest[: _CONTENT_LONGEST + 2]
        messages = [(frame, decode(bytes(frame))) for frame in frames if frame]
        self.bad += sum(message is None for _, message in messages)
        return [message for _, message in messages if message is not None]


def crc16(data: bytes) -> int:
    """Return the checksum CRC-16/CCITT-FALSE: polynomial 0x1021, start value 0xFFFF, bits not reflected."""
    return binascii.crc_hqx(data, 0xFFFF)


def cobs(content: bytes) -> bytes:
    """Encode at most 253 bytes by COBS, so that the code contains no zero byte."""
    # COBS treats blocks of 254 bytes without a zero in a special way. They cannot occur in such a short content.
    return b"".join(bytes([len(part) + 1]) + part for part in content.split(b"\0"))


def uncob(frame: bytes) -> bytes | None:
    """Decode a COBS frame; return None if it is damaged (a code points beyond its end, or it contains a zero)."""
    parts: list[bytes] = []
    at = 0
    while at < len(frame):
        end = at + frame[at]
        if frame[at] == 0 or end > len(frame):
            return None
        parts.append(frame[at + 1 : end])
        at = end
    return None if b"\0" in frame else b"\0".join(parts)
