"""A camera without hardware: it receives exposures and delivers them into slots from a separate thread.

It is the base class of simulated and replayed cameras. Like the stream of a real camera it takes a queued slot when
the transfer of a frame begins, fills the slot, and reports the slot when the transfer ends. If no slot is queued, the
frame is dropped.
"""

from __future__ import annotations

import heapq
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from queue import SimpleQueue

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.cameras.interface import Arrival, CameraDevice, CameraEvent, CameraHealth, Slot
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.supervised_thread import DEVICE_LIMIT_S, SupervisedThread


@dataclass(frozen=True)
class Exposure:
    """One frame that will be transferred, with the times of its transfer."""

    frame_id: int
    time_s: float
    begin_s: float
    end_s: float
    pixels: NDArray[np.uint8]
    share: float = 1.0


class VirtualCamera(CameraDevice):
    """A `CameraDevice` without hardware: it delivers the frames that callers pass to `expose`."""

    def __init__(self, number: int, read_clock: Callable[[], ClockReading]) -> None:
        self.number, self._read_clock = number, read_clock
        self._coming: list[tuple[float, int, Exposure]] = []
        self._order = count()
        self._slots: deque[Slot] = deque()
        self._change = threading.Condition()
        self._closing = False
        self._thread = SupervisedThread(self._deliver, f"camera-{number}", DEVICE_LIMIT_S)
        self._delivered = self._incomplete = self._dropped = 0

    def start(self, events: SimpleQueue[CameraEvent]) -> None:
        """Begin to deliver frames as arrivals into the queue `events`."""
        self._events = events
        self._thread.start()

    def expose(self, exposure: Exposure) -> None:
        """Schedule the transfer of a frame, for the times that are stored in `exposure`."""
        with self._change:
            # The running number keeps the order of exposures whose transfers begin at the same time.
            heapq.heappush(self._coming, (exposure.begin_s, next(self._order), exposure))
            self._change.notify()

    def queue(self, slot: Slot) -> None:
        """Queue memory for a frame that is to come."""
        with self._change:
            self._slots.append(slot)

    def take_back(self) -> list[int]:
        """Withdraw the slots that are queued and unused; return their numbers."""
        with self._change:
            numbers = [s.number for s in self._slots]
            self._slots.clear()
            return numbers

    def read_clock(self) -> ClockReading:
        """Compare the camera's clock with the host's clock."""
        return self._read_clock()

    def health(self) -> CameraHealth:
        """Return the camera's state with its counts of delivered, incomplete and dropped frames."""
        message = f"{self._dropped} frames dropped: no free slot in the ring" if self._dropped else ""
        return CameraHealth(not self._closing, message, None, self._delivered, self._incomplete)

    def threads(self) -> tuple[SupervisedThread, ...]:
        """Return the thread that delivers frames."""
        return (self._thread,)

    def close(self) -> None:
        """End the thread that delivers frames, and wait for its end; frames in transfer are dropped."""
        self._thread.expect_end()
        with self._change:
            self._closing = True
            self._change.notify()
        if self._thread.ident is not None:
            self._thread.join()

    def _deliver(self) -> None:
        while (exposure := self._next()) is not None:
            with self._change:
                slot = self._slots.popleft() if self._slots else None
            if slot is None:
                self._dropped += 1
                continue
            arrived = round(exposure.pixels.size * exposure.share)
            # Pixels that do not arrive stay black, because the slot was cleared before it was queued.
            slot.memory[:arrived] = exposure.pixels[:arrived]
            if not self._wait_until(exposure.end_s):
                return
            self._events.put(self._arrival(exposure, slot))

    def _arrival(self, exposure: Exposure, slot: Slot) -> Arrival:
        now_s = time.monotonic()
        if exposure.share < 1:
            self._incomplete += 1
            fault = f"only {exposure.share:.0%} of the frame arrived"
            return Arrival(self.number, slot.number, False, None, None, now_s, fault)
        self._delivered += 1
        return Arrival(self.number, slot.number, True, exposure.frame_id, exposure.time_s, now_s)

    def _next(self) -> Exposure | None:
        """Wait until the next transfer begins, and return it. Return None if the camera is closed."""
        with self._change:
            while not self._closing:
                wait_s = self._coming[0][0] - time.monotonic() if self._coming else None
                if wait_s is not None and wait_s <= 0:
                    return heapq.heappop(self._coming)[2]
                with self._thread.waiting():
                    self._change.wait(wait_s)
            return None

    def _wait_until(self, host_s: float) -> bool:
        """Wait until a host time; return False if the camera was closed meanwhile."""
        with self._change:
            while not self._closing and (left_s := host_s - time.monotonic()) > 0:
                with self._thread.waiting():
                    self._change.wait(left_s)
            return not self._closing
