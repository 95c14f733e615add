"""A camera without glass: it is handed exposures and delivers them into slots from a thread of its own.

Simulated and replayed cameras share it. Like a stream of a real camera it takes a queued slot when the
transfer of a frame begins, fills it, and announces it when the transfer ends; without a slot the frame
is lost.
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

from vaoi_station.acquisition.cameras.interface import Arrival, CameraHealth, CameraNews, Slot
from vaoi_station.acquisition.clocks import ClockReading


@dataclass(frozen=True)
class Exposure:
    """One frame on its way: taken at `time_s` of the camera's clock, transferred from begin to end (host time)."""

    frame_id: int
    time_s: float
    begin_s: float
    end_s: float
    pixels: NDArray[np.uint8]
    """All bytes of the frame, flat."""
    share: float = 1.0
    """How much of it gets through."""


class DeliveringCamera:
    """A `CameraDevice` fed by `expose`."""

    def __init__(self, number: int, read_clock: Callable[[], ClockReading]) -> None:
        self.number = number
        self.read_clock = read_clock
        self._coming: list[tuple[float, int, Exposure]] = []
        self._order = count()
        self._slots: deque[Slot] = deque()
        self._change = threading.Condition()
        self._closing = False
        self._thread: threading.Thread | None = None
        self._delivered = self._incomplete = self._starved = 0

    def start(self, arrivals: SimpleQueue[CameraNews]) -> None:
        """Begin to deliver."""
        self._thread = threading.Thread(target=self._deliver, args=(arrivals,), name=f"camera-{self.number}")
        self._thread.start()

    def expose(self, exposure: Exposure) -> None:
        """Hand over a frame; it is delivered at its times."""
        with self._change:
            heapq.heappush(self._coming, (exposure.begin_s, next(self._order), exposure))
            self._change.notify()

    def queue(self, slot: Slot) -> None:
        """Offer memory for a coming frame."""
        with self._change:
            self._slots.append(slot)

    def take_back(self) -> list[int]:
        """Withdraw the slots that were not used."""
        with self._change:
            numbers = [s.number for s in self._slots]
            self._slots.clear()
            return numbers

    def health(self) -> CameraHealth:
        """Counts of what was delivered."""
        message = f"{self._starved} frames found no memory" if self._starved else ""
        return CameraHealth(not self._closing, message, None, self._delivered, self._incomplete)

    def close(self) -> None:
        """End the thread; frames on their way are dropped."""
        with self._change:
            self._closing = True
            self._change.notify()
        if self._thread is not None:
            self._thread.join()

    def _deliver(self, arrivals: SimpleQueue[CameraNews]) -> None:
        while (exposure := self._next()) is not None:
            with self._change:
                slot = self._slots.popleft() if self._slots else None
            if slot is None:
                self._starved += 1
                continue
            got_through = round(exposure.pixels.size * exposure.share)
            slot.memory[:got_through] = exposure.pixels[:got_through]
            if not self._wait_until(exposure.end_s):
                return
            arrivals.put(self._announce(exposure, slot))

    def _announce(self, exposure: Exposure, slot: Slot) -> Arrival:
        now_s = time.monotonic()
        if exposure.share < 1:
            self._incomplete += 1
            fault = f"only {exposure.share:.0%} of the frame came through"
            return Arrival(self.number, slot.number, False, None, None, now_s, fault)
        self._delivered += 1
        return Arrival(self.number, slot.number, True, exposure.frame_id, exposure.time_s, now_s)

    def _next(self) -> Exposure | None:
        """The next transfer, when it is time for it; None when the camera is closed."""
        with self._change:
            while not self._closing:
                wait_s = self._coming[0][0] - time.monotonic() if self._coming else None
                if wait_s is not None and wait_s <= 0:
                    return heapq.heappop(self._coming)[2]
                self._change.wait(wait_s)
            return None

    def _wait_until(self, host_s: float) -> bool:
        """False if the camera was closed meanwhile."""
        with self._change:
            while not self._closing and (left_s := host_s - time.monotonic()) > 0:
                self._change.wait(left_s)
            return not self._closing
