"""The buffers of a stream are slots of the ring: Aravis' receive thread writes packets where the stitcher reads pixels.

A slot is in one of two hands. `queue` gives its address to the stream; it comes back by `told` when a frame has
ended in it, whole or not, or by `take_back` unused. Aravis has no call that takes a queued buffer out of a stream, but
stopping the receive thread and letting go of all buffers does: the thread has ended when the call returns, so no slot
that came back is ever written again, and each buffer's status says whether it was used. The thread is started anew
at once; its socket stays open all the while, so that packets wait in the kernel (both calls: 40 µs, measured).
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
"""The pulling thread looks at least so often whether it is to end."""
FILLING_S = 0.25
"""A frame that is being received is given so long to end before buffers are taken back; more than Aravis waits."""

FAULTS = {
    "timeout": "parts of the frame did not come in time",
    "missing-packets": "packets of the frame were lost on the way",
    "wrong-packet-id": "packets of the frame were out of order",
    "size-mismatch": "the frame is larger than configured",
    "aborted": "receiving the frame was broken off",
    "filling": "receiving the frame was broken off",
}
"""By the nickname of Aravis' status; newer versions may have more."""


@dataclass(frozen=True)
class FrameFormat:
    """What every whole frame must be."""

    width: int
    height: int
    code: int
    """Number of the pixel format."""


@dataclass(frozen=True)
class SlotResult:
    """What became of one slot. Without `whole`, frame id and time stamp are None: they may be an older frame's."""

    slot: Slot
    whole: bool
    frame_id: int | None
    time_ns: int | None
    """By the camera's clock."""
    host_time_s: float
    fault: str = ""


class SlotStream:
    """The buffers of one stream, and the thread that pulls them out when they are filled."""

    def __init__(self, stream: Any, kind: FrameFormat, on_slot: Callable[[SlotResult], None], name: str) -> None:
        """Pull at once; `told`, called in the pulling thread and those of `take_back` and `close`, must not wait."""
        self._stream = stream
        self._format, self._on_slot = kind, on_slot
        self._filling = aravis().BufferStatus.FILLING
        self._lock = threading.Lock()
        self._buffer_pulled = threading.Condition(self._lock)
        """Notified of every buffer that has been pulled out."""
        self._queued: dict[int, tuple[Any, Slot]] = {}
        """C pointer of a buffer → the buffer, its slot; all that the stream has."""
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._pull, name=f"{name}-frames")
        self._thread.start()

    def queue(self, slot: Slot) -> None:
        """Give a slot's memory to the stream; frames fill slots in the order they were queued."""
        buffer = aravis().Buffer.new(slot.memory.nbytes, slot.memory.ctypes.data)
        with self._lock:
            self._queued[hash(buffer)] = (buffer, slot)  # the hash of a GObject is its C pointer
            self._stream.push_buffer(buffer)

    def take_back(self) -> list[Slot]:
        """Withdraw what was not used; all other slots have been told of when this returns.

        A frame that is being received is waited for a while, then broken off.
        """
        self._wait_for_filling_frames()
        with self._lock:
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
        """End the pulling thread and take everything back: nothing is written any more. The slots that were not used.

        The stream itself ends with the last reference; that asks the camera, and is not done here.
        """
        if self._ending.is_set():
            return []
        unused = self.take_back()  # frames under way are pulled meanwhile
        self._ending.set()
        self._thread.join()
        return unused

    def counters(self) -> dict[str, int]:
        """The stream's own counters by name; what they count is Aravis' affair."""
        stream = self._stream
        names = (stream.get_info_name(k) for k in range(stream.get_n_infos()))
        return {name: stream.get_info_uint64_by_name(name) for name in names if name.startswith("n_")}

    def _pull(self) -> None:
        while not self._ending.is_set():
            buffer = self._stream.timeout_pop_buffer(POP_US)  # without the interpreter's lock
            if buffer is None:
                continue
            with self._buffer_pulled:
                _, slot = self._queued.pop(hash(buffer), (None, None))
                if slot is not None:  # else it has just been taken back, and told of
                    self._on_slot(self._result(buffer, slot))
                self._buffer_pulled.notify_all()

    def _result(self, buffer: Any, slot: Slot) -> SlotResult:
        host_time_s = time.monotonic()
        status = buffer.get_status()
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
