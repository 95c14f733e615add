"""A camera that sees the twin's line: it has a clock, a latency and a jitter of its own."""

from __future__ import annotations

import random

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.cameras.virtual import DeliveringCamera, Exposure
from vaoi_station.acquisition.causes import WRAP
from vaoi_station.acquisition.device_clock import DeviceClock

READOUT_S = 0.008
TRANSFER_S = 0.012
JITTER_S = 0.002
"""Largest extra delay of a transfer."""
TRIGGER_LATENCY_S = 5e-6
TRIGGER_JITTER_S = 2e-6
FIRST_ID = 65500
"""Numbers wrap after 35 frames, so that every longer test meets the wrap."""


class SimulatedCamera(DeliveringCamera):
    """Triggered by the line at host times; delivers what it is shown after read-out and transfer."""

    def __init__(self, number: int, clock: DeviceClock, exposure_us: float) -> None:
        super().__init__(number, clock.read)
        self._clock = clock
        self._exposure_s = exposure_us * 1e-6
        self._random = random.Random(number)
        self._id = FIRST_ID

    def trigger(
        self,
        host_s: float,
        pixels: NDArray[np.uint8],
        *,
        lost: bool = False,
        late_s: float = 0.0,
        share: float = 1.0,
        said: tuple[float, int] = (0.0, 0),
    ) -> None:
        """Expose at a host time. A lost frame is counted by the camera and never arrives.

        The frame says by `said` (s, ids) more than the truth when it was taken and which it is.
        """
        frame_id, self._id = (self._id - 1 + said[1]) % WRAP + 1, self._id % WRAP + 1
        if lost:
            return
        stamp_s = self._clock.device_s(host_s + said[0] + TRIGGER_LATENCY_S + self._random.uniform(0, TRIGGER_JITTER_S))
        begin_s = host_s + self._exposure_s + READOUT_S + self._random.uniform(0, JITTER_S) + late_s
        self.expose(Exposure(frame_id, stamp_s, begin_s, begin_s + TRANSFER_S, pixels, share))
