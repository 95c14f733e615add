"""Check that a frame is complete although Aravis says so: its size, its format, its bytes, and packets that came twice.

Aravis reports success when all packet numbers of a frame were seen. After a packet with a number outside the frame it
drops all further packets, but marks them as received; a trailer that comes early ends the frame early. In both cases
the memory keeps older pixels (tried with Aravis 0.8.26; 0.8.36 has the same code). A packet that comes twice may be
another one under a wrong number, because some cameras number re-sent packets wrongly (Aravis #311).
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from vaoi_station.acquisition.cameras.aravis.library import aravis, received_bytes

FAULTS = {
    "timeout": "parts of the frame did not arrive in time",
    "missing-packets": "packets of the frame were lost on the way",
    "wrong-packet-id": "packets of the frame were out of order",
    "size-mismatch": "the frame is larger than configured",
    "aborted": "receiving the frame was broken off",
    "filling": "receiving the frame was broken off",
}
"""Nickname of a buffer's status in Aravis → text for users. Newer versions of Aravis may have more nicknames."""
WITH_CHUNKS = "the camera adds chunk data to its frames: its ChunkModeActive was switched on; switch it off"
WITHOUT_CHUNKS = (
    "the frame does not state its exposure: the camera's ChunkModeActive was switched off; switch the camera off and on"
)
_DUPLICATES = "n_duplicated_packets"
"""Counter of a GigE stream: packets of which the number had been seen in the same frame."""


@dataclass(frozen=True)
class FrameFormat:
    """The size and the pixel format that a complete frame must have."""

    width: int
    height: int
    code: int
    """Code of the pixel format (PFNC)."""

    def __str__(self) -> str:
        return f"{self.width}×{self.height} px in format {self.code:#010x}"


class FrameCheck:
    """The check of all frames of one stream. Use it for every frame of the stream, in the order of their ends."""

    def __init__(self, stream: Any, kind: FrameFormat, chunk_bytes: int = 0) -> None:
        """Prepare the check.

        Args:
            stream: the `Aravis.Stream`.
            kind: size and pixel format that complete frames must have.
            chunk_bytes: size of the chunk data behind the pixels of complete frames; 0: they have none.
        """
        self._stream, self._format, self._chunk_bytes = stream, kind, chunk_bytes
        names = [stream.get_info_name(k) for k in range(stream.get_n_infos())]
        self._counts_duplicates = _DUPLICATES in names  # a USB stream does not
        self._duplicates = 0
        self._duplicates_ns = 0
        """Wall clock time, ns, at which the counter of duplicates was last seen to have grown."""

    def fault(self, buffer: Any, frame_bytes: int) -> str:
        """Return what is wrong with a frame that has ended; an empty text if it is complete.

        Args:
            buffer: the `Aravis.Buffer` that holds the frame.
            frame_bytes: size of the pixels of a complete frame.
        """
        status = buffer.get_status()
        repeated = self._began_before_duplicate(buffer)
        if status != aravis().BufferStatus.SUCCESS:
            return FAULTS.get(status.value_nick, f"Aravis calls the frame {status.value_nick!r}")
        if buffer.has_chunks() != bool(self._chunk_bytes):
            return WITHOUT_CHUNKS if self._chunk_bytes else WITH_CHUNKS
        kind = FrameFormat(buffer.get_image_width(), buffer.get_image_height(), buffer.get_image_pixel_format())
        if kind != self._format:
            return f"the frame is {kind}, not {self._format}"
        received, expected = received_bytes(buffer), frame_bytes + self._chunk_bytes
        if received != expected:
            return (
                f"{received} of its {expected} bytes arrived although it ended: packets had wrong numbers, or "
                "the camera sends shorter frames than it states; update its firmware"
            )
        if repeated:
            return (
                "a packet came twice, and one of them may have been another packet under a wrong number, as some "
                "cameras number re-sent packets; stop the loss of packets on the way, or update the camera's firmware"
            )
        return ""

    def _began_before_duplicate(self, buffer: Any) -> bool:
        """Whether a packet came twice since the first packet of a frame, in this frame or in one received with it."""
        if not self._counts_duplicates:
            return False
        duplicates = self._stream.get_info_uint64_by_name(_DUPLICATES)
        if duplicates != self._duplicates:
            self._duplicates, self._duplicates_ns = duplicates, time.time_ns()
        # If the clock was set back since, frames of now would seem to have begun before the duplicate, for as long.
        self._duplicates_ns = min(self._duplicates_ns, time.time_ns())
        # The counter is of the stream and not of the frame. If this thread was late, the duplicate may be of a frame
        # that ended later, so every frame that had begun when the counter was read is suspect.
        return bool(buffer.get_system_timestamp() <= self._duplicates_ns)
