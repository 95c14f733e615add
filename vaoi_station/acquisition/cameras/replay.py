"""A camera that delivers the frames of a recording."""

from __future__ import annotations

import time
from itertools import count

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.cameras.virtual import Exposure, VirtualCamera
from vaoi_station.acquisition.device_clock import DeviceClock


class ReplayCamera(VirtualCamera):
    """A camera that delivers recorded frames; it shares its clock with the replayed controller."""

    def __init__(self, number: int, clock: DeviceClock) -> None:
        super().__init__(number, clock.read_exactly)
        self._ids = count(1)

    def play(self, time_s: float, pixels: NDArray[np.uint8] | None) -> None:
        """Deliver a recorded frame now, with time stamp `time_s`. `pixels` is None if the recording lacks the frame."""
        # A frame that the recording lacks uses an id too, so that the gap in the ids shows a loss in transfer.
        frame_id = next(self._ids)
        if pixels is not None:
            now_s = time.monotonic()
            self.expose(Exposure(frame_id, time_s, now_s, now_s, pixels))
