"""Frames of cameras with settings on trial: one pulse for each request, its figures, and its picture."""

from __future__ import annotations

import itertools
import threading

from vaoi_station.api.cameras.models import CameraTrialFrame, CameraTrialRequest
from vaoi_station.api.cameras.newest_frames import figures_of, for_display
from vaoi_station.errors import NotFoundError
from vaoi_station.files.images import Image
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.lighting.camera_trial import TRIAL_S
from vaoi_station.runs.lighting.lighting import TrialSettings


class CameraTrials:
    """Tries settings, and keeps the newest frame for its picture. Methods may be called from any thread."""

    def __init__(self, coordinator: StationCoordinator) -> None:
        self._coordinator = coordinator
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._newest: tuple[int, int, Image] | None = None
        """Camera, number and pixels of the newest frame."""

    def shoot(self, camera: int, wanted: CameraTrialRequest) -> CameraTrialFrame:
        """Fire one pulse with these settings; return the figures of the camera's frame."""
        settings = TrialSettings(wanted.light, wanted.on_us, wanted.exposure_us, wanted.gain_db)
        taken = self._coordinator.lighting.try_settings(camera, settings)
        with self._lock:
            number = next(self._numbers)
            self._newest = camera, number, taken.pixels
        return CameraTrialFrame(
            camera=camera,
            number=number,
            light=taken.light,
            on_us=taken.on_us,
            exposure_us=taken.exposure_us,
            gain_db=taken.gain_db,
            expires_in_s=TRIAL_S,
            **figures_of(taken.pixels).model_dump(),
        )

    def frame(self, camera: int, number: int | None) -> Image:
        """Return the newest frame; `NotFoundError` if it is of another camera or trial, or there is none."""
        with self._lock:
            newest = self._newest
        if newest is None or newest[0] != camera or number not in (None, newest[1]):
            raise NotFoundError(f"There is no trial of camera {camera}.", action="Fire a pulse.", code="no-trial-frame")
        return newest[2]

    def picture(self, camera: int, number: int | None) -> bytes:
        """Return the newest frame as JPEG; raises the errors of `frame`."""
        return for_display(self.frame(camera, number))

    def end(self) -> None:
        """Set the exposures of station.toml again, and forget the picture."""
        self._coordinator.lighting.end_trial()
        with self._lock:
            self._newest = None
