"""Light programs and trials of a held station: a frame is as bright as exposure and gain make it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from tests.api.held.programs import held_programs
from vaoi_station.errors import NotFoundError, StateError
from vaoi_station.model.recording import linear_gain
from vaoi_station.runs.lighting.trials import TrialPicture, TrialSettings
from vaoi_station.runs.states.tables import StationState


class HeldLighting:
    """Stands for `Lighting`; `tried` has the settings of all pulses, `ended` counts the ends of trials."""

    def __init__(self, station: Any, cameras: int = 3, px_per_mm: float = 8.0) -> None:
        self._station, self._cameras = station, cameras
        self.programs = held_programs(cameras, px_per_mm)
        self.tried: list[tuple[int, TrialSettings]] = []
        self.ended = 0
        self.below: Callable[[int], Any] | None = None
        """Function that returns what each camera sees, in place of fields."""

    def try_settings(self, camera: int, wanted: TrialSettings) -> TrialPicture:
        """Return fields like those of a chessboard, as bright as exposure and gain make them."""
        if camera >= self._cameras:
            raise NotFoundError(f"There is no camera {camera}; the station has {self._cameras}.")
        if self._station.state is not StationState.IDLE:
            raise StateError(f"The line is {self._station.state}.", action="Disarm it.", code="line-armed")
        self.tried.append((camera, wanted))
        exposure_us, gain_db = wanted.exposure_us or 250.0, wanted.gain_db or 0.0
        grey = min(exposure_us / 250.0 * linear_gain(gain_db) * 120.0, 255.0)
        fields = np.kron(np.indices((6, 8)).sum(0) % 2, np.ones((40, 40)))
        pixels = cv2.GaussianBlur((20 + fields * (grey - 20)).astype(np.uint8), (0, 0), 0.8)
        if self.below is not None:
            pixels = self.below(camera)
        return TrialPicture(pixels, wanted.light or "even", wanted.on_us or 200.0, exposure_us, gain_db)

    def end_trial(self) -> None:
        """Count."""
        self.ended += 1
