"""Streams whose buffers are slots of the ring: Aravis' receive thread writes packets where the stitcher reads pixels.

A slot belongs either to the stream or to the caller. `queue` gives its address to the stream. It comes back through
`on_slot` when a frame has ended in it, complete or not, or unused from `take_back`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from vaoi_station.acquisition.cameras.aravis.library import aravis
from vaoi_station.acquisition.cameras.interface import Slot

POP_US = 50_000
"""Longest wait of the pulling thread before it checks whether to end, in µs."""
FILLING_S = 0.25
"""Time that a frame under way has to end before buffers are taken back; longer than Aravis' frame retention."""

FAULTS = {
    "timeout": "parts of the frame did not arrive in time",
    "missing-packets": "packets of the frame were lost on the way",
    "wrong-packet-id": "packets of the frame were out of order",
    "size-mismatch": "the frame is larger than configured",
    "aborted": "receiving the frame was broken off",
    "filling": "receiving the frame was broken off",
}
"""Texts by the nickname of Aravis' status; newer versions may have more."""


@dataclass(frozen=True)
class FrameFormat:
    """Size and pixel format of a complete frame."""

    width: int
    height: int
    code: int
    """Code of the pixel format (PFNC)."""


@dataclass(frozen=True)
class SlotResult:
    """The outcome of one slot; frame id and time stamp are None unless `whole`."""

    slot: Slot
    whole: bool
    frame_id: int | None
    time_ns: int | None
    """Time stamp by the camera's clock."""
    host_time_s: float
    fault: str = ""


class SlotStream:
    """The buffers of one stream, and the thread that pulls filled ones."""

    def __init__(self, stream: Any, kind: FrameFormat, on_slot: Callable[[SlotResult], None], name: str) -> None:
        """Start pulling; `on_slot` runs in the pulling thread and in callers of `take_back`, and must not block."""
        self._stream = stream
        self._format, self._on_slot = kind, on_slot
        self._filling = aravis().BufferStatus.FILLING
        self._lock = threading.Lock()
        self._buffer_pulled = threading.Condition(self._lock)
        """Notified of every buffer that was pulled."""
        self._queued: dict[int, tuple[Any, Slot]] = {}
        """C pointer of a buffer → the buffer and its slot, for all buffers of the stream."""
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._pull, name=f"{name}-frames")
        self._thread.start()

    def queue(self, slot: Slot) -> None:
        """Give a slot's memory to the stream; frames fill slots in the order they were queued."""
        buffer = aravis().Buffer.new(slot.memory.nbytes, slot.memory.ctypes.data)
        with self._lock:
            # The hash of a PyGObject is its C pointer, and a popped buffer may have a new Python wrapper.
            self._queued[hash(buffer)] = (buffer, slot)
            self._stream.push_buffer(buffer)

    def take_back(self) -> list[Slot]:
        """Withdraw and return the unused slots; all others have been passed to `on_slot` when this returns.

        A frame under way gets `FILLING_S` to end; then its reception is aborted.
        """
        self._wait_for_filling_frames()
        with self._lock:
            # Aravis cannot remove a queued buffer. Stopping its receive thread and releasing all buffers can: when the
            # call returns, the thread has ended, so no returned slot is written again. The socket stays open and
            # packets wait in the kernel; both calls together take 40 µs (measured, decisions/0009).
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
        """End the pulling thread and return the unused slots; no slot is written afterwards."""
        # The stream itself ends with its last reference, which the connection drops: that may access the camera.
        if self._ending.is_set():
            return []
        # Before the thread ends, because it pulls the frames under way meanwhile.
        unused = self.take_back()
        self._ending.set()
        self._thread.join()
        return unused

    def counters(self) -> dict[str, int]:
        """Return the stream's counters by name."""
        # For diagnosis only: `n_underruns` counts packets, `n_missing_packets` the whole tail of a frame (measured).
        stream = self._stream
        names = (stream.get_info_name(k) for k in range(stream.get_n_infos()))
        return {name: stream.get_info_uint64_by_name(name) for name in names if name.startswith("n_")}

    def _pull(self) -> None:
        while not self._ending.is_set():
            # Releases the GIL. A signal callback instead would run Python in the receive thread (Aravis #453, #714,
            # #941).
            buffer = self._stream.timeout_pop_buffer(POP_US)
            if buffer is None:
                continue
            with self._buffer_pulled:
                _, slot = self._queued.pop(hash(buffer), (None, None))
                # Without a slot: `take_back` has just handled the buffer.
                if slot is not None:
                    self._on_slot(self._result(buffer, slot))
                self._buffer_pulled.notify_all()

    def _result(self, buffer: Any, slot: Slot) -> SlotResult:
        host_time_s = time.monotonic()
        status = buffer.get_status()
        # Without SUCCESS id, time stamp and geometry may be those of an older frame: Aravis writes them with the leader
        # (measured: id 65401 again where 65406 was due).
        if status != aravis().BufferStatus.SUCCESS:
            fault = FAULTS.get(status.value_nick, f"Aravis calls the frame {status.value_nick!r}")
            return SlotResult(slot, False, None, None, host_time_s, fault)
        kind = FrameFormat(buffer.get_image_width(), buffer.get_image_height(), buffer.get_image_pixel_format())
        if kind != self._format:
            return SlotResult(
                slot, False, None, None, host_time_s, f"the frame is {_describe(kind)}, not {_describe(self._format)}"
            )
        return SlotResult(slot, True, buffer.get_frame_id(), buffer.get_timestamp(), host_time_s)

    def _wait_for_filling_frames(self) -> None:
        with self._buffer_pulled:
            self._buffer_pulled.wait_for(self._none_filling, FILLING_S)

    def _none_filling(self) -> bool:
        return not any(buffer.get_status() == self._filling for buffer, _ in self._queued.values())


def _describe(kind: FrameFormat) -> str:
    return f"{kind.width}×{kind.height} px in format {kind.code:#010x}"
