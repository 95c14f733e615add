"""Receive frames directly into slots of the ring, and check that they are complete although Aravis says so.

A slot belongs either to the stream or to the caller. Aravis reports success when all packet numbers of a frame were
seen; after a packet with a number outside the frame, or a trailer that comes early, the memory keeps older pixels
(tried with 0.8.26). A packet that comes twice is one that was late and was sent again, or another one under a wrong
number (Aravis #311): of two packets with one number, every 0.8 keeps the first.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from vaoi_station.acquisition.cameras.aravis.library import aravis, glib_error, received_bytes
from vaoi_station.acquisition.cameras.interface import Slot, StatedExposure
from vaoi_station.supervised_thread import SupervisedThread

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
_DUPLICATES, _REQUESTS = "n_duplicated_packets", "n_resend_requests"
"""Counters of a GigE stream: packets of which the number had been seen in the same frame; packets asked for again."""


@dataclass(frozen=True)
class FrameFormat:
    """The size and the pixel format that a complete frame must have."""

    width: int
    height: int
    code: int

    def __str__(self) -> str:
        return f"{self.width}×{self.height} px in format {self.code:#010x}"


class FrameCheck:
    """The check of all frames of one stream. Use it for every frame of the stream, in the order of their ends."""

    def __init__(self, stream: Any, kind: FrameFormat, chunk_bytes: int = 0, misnumbers: bool = False) -> None:
        """Prepare the check. `misnumbers`: no packet that came twice is trusted (`families.misnumbers_resends`)."""
        self._stream, self._format, self._chunk_bytes = stream, kind, chunk_bytes
        names = [stream.get_info_name(k) for k in range(stream.get_n_infos())]
        self._counts_duplicates = _DUPLICATES in names  # a USB stream does not
        self._counts_requests = _REQUESTS in names and not misnumbers
        self._duplicates = 0
        self._requests = (0, 0)
        """Packets asked for again up to the last two checks."""
        self._duplicates_ns = 0
        """Wall clock time, ns, at which more packets were last seen to have come twice than were asked for again."""

    def fault(self, buffer: Any, frame_bytes: int) -> str:
        """Return what is wrong with a frame that has ended; an empty text if it is complete."""
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
        """Whether a doubtful packet came twice since a frame began, in this frame or in one received with it."""
        if not self._counts_duplicates:
            return False
        duplicates = self._stream.get_info_uint64_by_name(_DUPLICATES)
        requests = self._stream.get_info_uint64_by_name(_REQUESTS) if self._counts_requests else 0
        # Each request brings one packet again, and the late packet itself may still come: this number may come twice
        # with the same content. The request may be one of the frame before, which was received at the same time.
        if duplicates - self._duplicates > requests - self._requests[0]:
            self._duplicates_ns = time.time_ns()
        self._duplicates, self._requests = duplicates, (self._requests[1], requests)
        # If the clock was set back since, frames of now would seem to have begun before the duplicate, for as long.
        self._duplicates_ns = min(self._duplicates_ns, time.time_ns())
        # The counter is of the stream and not of the frame. If this thread was late, the duplicate may be of a frame
        # that ended later, so every frame that had begun when the counter was read is suspect.
        return bool(buffer.get_system_timestamp() <= self._duplicates_ns)


POP_US = 50_000
"""Longest wait of the pulling thread for a buffer, in µs; after it the thread checks whether the stream is closed."""
FILLING_S = 0.25
"""Time, s, for which frames that are being received may still end before their buffers are taken back.

It is longer than the time for which Aravis waits for missing packets."""


class ChunkReader:
    """Reads exposure and gain that the frames of one camera state behind their pixels (chunk data)."""

    def __init__(self, camera: Any, nbytes: int) -> None:
        """Prepare to read chunk data of `nbytes` per frame, which is switched on."""
        self.nbytes = nbytes
        # The parser has a description of its own: it is used by the pulling thread, while others access the camera.
        self._parser = camera.create_chunk_parser()
        self._has_gain = bool(camera.is_gain_available())

    def read(self, buffer: Any) -> StatedExposure | None:
        """Return what a complete frame states; None if it cannot be read."""
        try:
            exposure_us = float(self._parser.get_float_value(buffer, "ChunkExposureTime"))
            gain_db = float(self._parser.get_float_value(buffer, "ChunkGain")) if self._has_gain else None
        except glib_error():
            return None
        return StatedExposure(exposure_us, gain_db)


@dataclass(frozen=True)
class SlotResult:
    """The outcome of receiving a frame into one slot. Frame id and time stamp are None unless the frame is complete."""

    slot: Slot
    whole: bool
    frame_id: int | None
    time_ns: int | None
    host_time_s: float
    fault: str = ""
    stated: StatedExposure | None = None


class SlotStream:
    """A stream of frames into slots. A thread takes the filled slots from the stream and reports them."""

    def __init__(
        self,
        stream: Any,
        kind: FrameFormat,
        on_slot: Callable[[SlotResult], None],
        name: str,
        chunks: ChunkReader | None = None,
        misnumbers: bool = False,
    ) -> None:
        """Create the stream of slots and start its thread."""
        self._stream, self._chunks, self._on_slot = stream, chunks, on_slot
        self._check = FrameCheck(stream, kind, chunks.nbytes if chunks is not None else 0, misnumbers)
        self._filling = aravis().BufferStatus.FILLING
        self._lock = threading.Lock()
        self._buffer_pulled = threading.Condition(self._lock)
        self._queued: dict[int, tuple[Any, Slot]] = {}
        """C pointer of a buffer → the buffer and its slot, for all buffers that the stream has."""
        self._ending = threading.Event()
        self.thread = SupervisedThread(self._pull, f"{name}-frames")
        self.thread.start()

    def queue(self, slot: Slot) -> None:
        """Give a slot's memory to the stream. Frames fill slots in the order in which the slots were given."""
        buffer = aravis().Buffer.new(slot.memory.nbytes + slot.room, slot.memory.ctypes.data)
        with self._lock:
            # The hash of a PyGObject is its C pointer, and a popped buffer may have a new Python wrapper.
            self._queued[hash(buffer)] = (buffer, slot)
            self._stream.push_buffer(buffer)

    def take_back(self) -> list[Slot]:
        """Withdraw and return the unused slots. All other slots have been passed to `on_slot` when this method returns.

        A frame that is being received gets `FILLING_S` to end; after this time its reception is aborted.
        """
        self._wait_for_filling_frames()
        with self._lock:
            # Aravis cannot remove a single queued buffer, but it can stop its receive thread and release all buffers.
            # When `stop_thread` returns, the thread has ended, so no returned slot is written again. The socket stays
            # open, and packets wait in the kernel; stop and start together take 40 µs (measured, decisions/0009).
            self._stream.stop_thread(True)
            out, self._queued = self._queued, {}
            self._stream.start_thread()
        unused = []
        for buffer, slot in out.values():
            if buffer.get_status() == aravis().BufferStatus.CLEARED:
                unused.append(slot)
            else:
                self._on_slot(self._result(buffer, slot))
        return unused

    def close(self) -> list[Slot]:
        """End the thread and return the unused slots. After this call no frame is written into any slot."""
        # The `Aravis.Stream` ends when the connection drops the last reference to it, because its end may access the
        # camera.
        if self._ending.is_set():
            return []
        # They are taken back before the thread ends, because this thread pulls the frames that are still being
        # received.
        unused = self.take_back()
        self.thread.expect_end()
        self._ending.set()
        self.thread.join()
        return unused

    def counters(self) -> dict[str, int]:
        """Return the stream's counters of frames and packets, by name."""
        # For diagnosis only: `n_underruns` counts packets, `n_missing_packets` the whole tail of a frame (measured).
        stream = self._stream
        names = (stream.get_info_name(k) for k in range(stream.get_n_infos()))
        return {name: stream.get_info_uint64_by_name(name) for name in names if name.startswith("n_")}

    def _pull(self) -> None:
        while not self._ending.is_set():
            self.thread.beat()
            # The call releases the GIL while it waits. A signal callback instead would run Python in Aravis' receive
            # thread, which crashed (Aravis #453, #714, #941).
            buffer = self._stream.timeout_pop_buffer(POP_US)
            if buffer is None:
                continue
            with self._buffer_pulled:
                _, slot = self._queued.pop(hash(buffer), (None, None))
                # There is no slot if `take_back` has just handled the buffer.
                if slot is not None:
                    self._on_slot(self._result(buffer, slot))
                self._buffer_pulled.notify_all()

    def _result(self, buffer: Any, slot: Slot) -> SlotResult:
        host_time_s = time.monotonic()
        # Without SUCCESS, frame id, time stamp and size may be those of an older frame, because Aravis writes them when
        # the leader packet arrives (measured: id 65401 again instead of 65406).
        if fault := self._check.fault(buffer, slot.memory.nbytes):
            return SlotResult(slot, False, None, None, host_time_s, fault)
        stated = None if self._chunks is None else self._chunks.read(buffer)
        if self._chunks is not None and stated is None:
            return SlotResult(slot, False, None, None, host_time_s, "the exposure in its chunk data cannot be read")
        return SlotResult(slot, True, buffer.get_frame_id(), buffer.get_timestamp(), host_time_s, stated=stated)

    def _wait_for_filling_frames(self) -> None:
        with self._buffer_pulled:
            self._buffer_pulled.wait_for(self._none_filling, FILLING_S)

    def _none_filling(self) -> bool:
        return not any(buffer.get_status() == self._filling for buffer, _ in self._queued.values())
