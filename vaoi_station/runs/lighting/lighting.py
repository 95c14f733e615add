"""Light programs and settings on trial, for callers such as the REST service."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any, NamedTuple, Protocol

from numpy.typing import NDArray

from vaoi_station.acquisition.cameras.interface import CameraExposure
from vaoi_station.acquisition.controller.filming_plan import beyond_camera
from vaoi_station.acquisition.process.messages import FireTrial, Grant, Health
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, InputError, NotFoundError, StateError
from vaoi_station.runs.lighting.camera_trial import CameraTrial, TrialShot
from vaoi_station.runs.lighting.program_check import LightPrograms

SHOT_S = 25.0
"""Longest wait for the frames of a pulse: clocks that are not known well enough yet take up to 10 s of it."""


class TrialSettings(NamedTuple):
    """What one camera is to try; None: as in station.toml."""

    light: str | None = None
    on_us: float | None = None
    exposure_us: float | None = None
    gain_db: float | None = None


class TrialPicture(NamedTuple):
    """A frame of a trial, and what it was taken with."""

    pixels: NDArray[Any]
    light: str
    on_us: float | None
    exposure_us: float
    gain_db: float


class Asking(Protocol):
    """The methods of the coordinator's inbox that are used here."""

    def ask(self, work: Callable[..., Any], *args: Any) -> Any:
        """Let the coordinator's thread call a function; return its value."""

    def wait(self, answer: Future[Any], do: Callable[[], Any], timeout_s: float | None = None) -> Any:
        """Let the coordinator's thread call a function, and wait for an answer."""

    def post(self, work: Callable[..., Any], *args: Any) -> None:
        """Let the coordinator's thread call a function, without waiting."""


class Devices(Protocol):
    """What the coordinator's thread knows of the devices."""

    trial: CameraTrial

    def devices(self) -> Health | None:
        """Return the latest report of the devices; None while there is none."""


class Frames(Protocol):
    """The one method of the ring that is used here."""

    def snapshot(self, slot: int, generation: int) -> NDArray[Any]:
        """Return a copy of the frame in a slot."""


class Lighting:
    """The checks of light programs, and the trials of cameras. Methods may be called from any thread but one."""

    def __init__(
        self,
        config: StationConfig,
        px_per_mm: Sequence[float],
        ring: Frames,
        inbox: Asking,
        core: Devices,
        shot_s: float = SHOT_S,
    ) -> None:
        """Connect the parts; `core` is used in the thread of `inbox`. A pulse is awaited for `shot_s`."""
        self._config, self._ring, self._inbox, self._core, self._trial = config, ring, inbox, core, core.trial
        self._shot_s = shot_s
        self.programs = LightPrograms(config, px_per_mm, lambda: inbox.ask(core.devices))

    def try_settings(self, camera: int, wanted: TrialSettings) -> TrialPicture:
        """Fire one pulse with settings on trial, and return the frame of the camera.

        Raises:
            NotFoundError: the station has no such camera.
            InputError: the light is unknown, or a value is beyond a limit.
            StateError: the line is not disarmed, or another pulse is under way.
            BusyError: there is not enough memory.
            DeviceError: a camera or the controller refuses, or the frame did not arrive.
        """
        cameras = self._config.cameras
        if camera >= len(cameras):
            raise NotFoundError(f"There is no camera {camera}; the station has {len(cameras)}.")
        own, known = cameras[camera], self._config.controller.lights
        if wanted.light is not None and self._config.controller.backend == "serial" and wanted.light not in known:
            limit = f"one of {', '.join(map(repr, known)) or 'none'}, the lights of station.toml"
            raise InputError.field("trial", "light", wanted.light, limit)
        exposure_us = own.exposure_us if wanted.exposure_us is None else wanted.exposure_us
        gain_db = own.gain_db if wanted.gain_db is None else wanted.gain_db
        # A longer exposure could still be under way when the line is armed, and its frame would not be awaited.
        if exposure_us > (most_us := self._config.line.trigger_period_s * 1e6):
            limit = f"at most {most_us:.0f} µs, the trigger period of the line"
            raise InputError.field("trial", "exposure_us", exposure_us, limit)
        exposures = [CameraExposure((c.exposure_us,), c.gain_db) for c in cameras]
        exposures[camera] = CameraExposure((exposure_us,), gain_db)
        self._require_limits(camera, exposures[camera])
        light = wanted.light or next(iter(self._config.controller.light_sequence), "")
        on_us = wanted.on_us if wanted.on_us is not None or light not in known else known[light].on_us
        shot = self._fire(FireTrial(Grant("", 0), tuple(exposures), light, on_us))
        try:
            frame = next((f for f in shot.report.frames if f.camera == camera and f.slot is not None), None)
            if frame is None or frame.slot is None:
                missing = next((f.cause for f in shot.report.frames if f.camera == camera), "it never arrived")
                raise DeviceError(f"{own.label}: no frame ({missing}).", action="Check its cable and its trigger.")
            pixels = self._ring.snapshot(frame.slot, shot.bay.generation)
        finally:
            self._inbox.post(self._trial.release, shot.run)
        return TrialPicture(pixels, light, on_us, exposure_us, gain_db)

    def _require_limits(self, camera: int, wanted: CameraExposure) -> None:
        """Raise InputError if a value is beyond the limits that the camera has stated, as for a light program."""
        # The camera may take such a value, and do something else.
        health = self._inbox.ask(self._core.devices)
        limits = health.cameras[camera].limits if health is not None else None
        if limits is not None:
            label = self._config.cameras[camera].label
            for fault in beyond_camera(wanted, (wanted.gain_db,), limits, camera, label, ("trial", "")):
                raise fault.error

    def end_trial(self) -> None:
        """Set the exposures of station.toml again."""
        self._inbox.ask(self._trial.end)

    def _fire(self, wanted: FireTrial) -> TrialShot:
        answer: Future[TrialShot] = Future()
        self._inbox.ask(self._trial.fire, wanted, answer)
        try:
            shot: TrialShot = self._inbox.wait(answer, lambda: None, self._shot_s)
        except TimeoutError:
            self._inbox.post(self._trial.abandon, answer)
            raise DeviceError(f"The pulse gave no frames within {self._shot_s:g} s.", action="Try again.") from None
        except StateError:
            # The refusal of a pulse has freed its memory; a station that stops has not.
            self._inbox.post(self._trial.abandon, answer)
            raise
        return shot
