"""Packets of GVSP (GigE Vision streaming protocol) for one frame: leader, payload, trailer."""

from __future__ import annotations

import struct
from dataclasses import dataclass

LEADER, TRAILER, PAYLOAD = 1, 2, 3
IMAGE, WITH_CHUNKS = 0x0001, 0x4000
"""Payload type of an image, and the bit that states that chunk data follow it."""
HEADERS, EXTENDED_HEADERS = 36, 48
"""Bytes of a packet that are not pixels: IP 20, UDP 8, and GVSP 8 or, with ids of 64 bits, 20."""
MONO8 = 0x01080001


@dataclass(frozen=True)
class Stream:
    """The region, format and packet size that a client has set, and whether frame ids have 64 bits."""

    width: int
    height: int
    packet_bytes: int
    extended: bool = False
    pixel_format: int = MONO8
    offset_px: tuple[int, int] = (0, 0)

    def header(self, content: int, frame_id: int, packet_id: int) -> bytes:
        """Return the header of a packet with status 0."""
        if self.extended:
            return struct.pack(">HHIQI", 0, 0, 0x80000000 | content << 24, frame_id, packet_id)
        return struct.pack(">HHI", 0, frame_id, content << 24 | packet_id)

    def payload(self, frame_id: int, packet_id: int, content: bytes | memoryview) -> bytes:
        """Return a packet with pixels."""
        return b"".join((self.header(PAYLOAD, frame_id, packet_id), content))

    def frame(self, pixels: bytes | memoryview, frame_id: int, ticks: int, payload_type: int = IMAGE) -> list[bytes]:
        """Return all packets of a frame; the index of a packet is its packet id."""
        step = self.packet_bytes - (EXTENDED_HEADERS if self.extended else HEADERS)
        leader = struct.pack(
            ">HHQIIIIIHH", 0, payload_type, ticks, self.pixel_format, self.width, self.height, *self.offset_px, 0, 0,
        )  # fmt: skip
        packets = [self.header(LEADER, frame_id, 0) + leader]
        for start in range(0, len(pixels), step):
            packets.append(self.payload(frame_id, len(packets), pixels[start : start + step]))
        trailer = struct.pack(">HHI", 0, payload_type, self.height)
        return [*packets, self.header(TRAILER, frame_id, len(packets)) + trailer]
