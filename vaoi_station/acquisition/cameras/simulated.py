"""A camera of the simulated line, with a simulated clock, latency and jitter."""

from __future__ import annotations

import random

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.cameras.interface import CameraExposure
from vaoi_station.acquisition.cameras.virtual import Exposure, VirtualCamera
from vaoi_station.acquisition.causes import MAX_FRAME_ID
from vaoi_station.acquisition.device_clock import DeviceClock
from vaoi_station.model.light_program import linear_gain

READOUT_S = 0.008
TRANSFER_S = 0.012
JITTER_S = 0.002
"""Largest random delay of a transfer, s."""
TRIGGER_LATENCY_S = 5e-6
TRIGGER_JITTER_S = 2e-6
FIRST_ID = 65500
"""First frame id. The ids wrap within the first 40 frames, so that every longer test includes the wrap."""


class SimulatedCamera(VirtualCamera):
    """A camera that the simulated line triggers; it delivers the given pixels after exposure, read-out and transfer."""

    def __init__(self, number: int, clock: DeviceClock, exposure_us: float) -> None:
        super().__init__(number, clock.read)
        self._clock = clock
        self._exposure_s = exposure_us * 1e-6
        self._wanted: CameraExposure | None = None
        self._random = random.Random(number)
        self._id = FIRST_ID

    def set_exposure(self, wanted: CameraExposure) -> None:
        """Remember the exposure for single pulses: the frames of boards are rendered with that of their program."""
        self._wanted = wanted

    def brightness(self, on_us: float | None) -> float:
        """Return how many times as bright a single pulse is as one with the exposure of station.toml."""
        if self._wanted is None:
            return 1.0
        exposure_us = self._wanted.exposures_us[0]
        lit_us = exposure_us if on_us is None else min(exposure_us, on_us)
        return lit_us * 1e-6 / self._exposure_s * linear_gain(self._wanted.gain_db)

    def trigger(
        self,
        host_s: float,
        pixels: NDArray[np.uint8],
        *,
        lost: bool = False,
        late_s: float = 0.0,
        share: float = 1.0,
        stamp_error_s: float = 0.0,
        id_error: int = 0,
    ) -> None:
        """Expose one frame at a host time.

        Args:
            host_s: time of the pulse.
            pixels: flat bytes of the frame.
            lost: whether the frame is lost: the camera counts it, but it never arrives.
            late_s: additional delay of the transfer.
            share: share of the frame's bytes that arrives, 0 … 1.
            stamp_error_s: error that is added to the time stamp.
            id_error: error that is added to the frame id.
        """
        # Ids count from 1 to 65535 and then from 1 again, as those of GigE Vision.
        frame_id, self._id = (self._id - 1 + id_error) % MAX_FRAME_ID + 1, self._id % MAX_FRAME_ID + 1
        if lost:
            return
        latency_s = TRIGGER_LATENCY_S + self._random.uniform(0, TRIGGER_JITTER_S)
        stamp_s = self._clock.device_s(host_s + stamp_error_s + latency_s)
        begin_s = host_s + self._exposure_s + READOUT_S + self._random.uniform(0, JITTER_S) + late_s
        self.expose(Exposure(frame_id, stamp_s, begin_s, begin_s + TRANSFER_S, pixels, share))
