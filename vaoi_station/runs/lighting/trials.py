"""Settings of a camera on trial while the line is disarmed: one pulse at a time, into memory of its own.

A trial is filmed as a run of one row that no other part of the station knows. It changes nothing for good: arming sets
the exposures of the plan, and without a further pulse those of station.toml come back after `TRIAL_S`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from numpy.typing import NDArray

from vaoi_station.acquisition.cameras.interface import CameraExposure
from vaoi_station.acquisition.controller.filming_plan import beyond_camera
from vaoi_station.acquisition.process import messages
from vaoi_station.acquisition.ring import Ring
from vaoi_station.config import StationConfig
from vaoi_station.errors import BusyError, DeviceError, InputError, NotFoundError, StateError, VaoiError
from vaoi_station.runs.lighting.programs import LightPrograms
from vaoi_station.runs.run.inbox import Inbox
from vaoi_station.runs.run.memory import Bay, Memory
from vaoi_station.runs.states.tables import StationState

TRIAL_S = 10.0
"""Time after the last pulse of a trial until the exposures of station.toml are set again, s."""
SHOT_S = 25.0
"""Longest wait for the frames of a pulse: clocks that are not known well enough yet take up to 10 s of it."""
LEAST_BAYS = 2
"""Bays that must be available for a pulse: one for its frames, and one for the board of an order that comes at once."""
_ARMED = frozenset({StationState.ARMED, StationState.FILMING, StationState.BLOCKED})
"""States in which the cameras have the exposures of a plan."""


@dataclass(frozen=True)
class TrialShot:
    """The frames of one pulse of a trial. Their memory is granted until `CameraTrial.release`."""

    run: str
    bay: Bay
    report: messages.RunFinished


class Sender(Protocol):
    """Takes commands for the acquisition process."""

    def send(self, command: messages.Command) -> None:
        """Send a command, without waiting for its effect."""


class CameraTrial:
    """The trial under way. Used by the coordinator's thread only."""

    def __init__(
        self,
        acquisition: Sender,
        state: Callable[[], StationState],
        memory: Memory,
        on_evicted: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare trials. `on_evicted` gets the run whose frames were given up for a pulse, as for a board."""
        self._acquisition, self._state, self._memory = acquisition, state, memory
        self._on_evicted, self._clock = on_evicted, clock
        self._count = 0
        self._bay: Bay | None = None
        self._completion: Future[TrialShot] | None = None
        self._until_s = math.inf

    def fire(self, wanted: messages.FireTrial, completion: Future[TrialShot]) -> None:
        """Fire one pulse; the completion gets its frames, or the refusal. The memory of `wanted` is replaced.

        Raises:
            StateError: the line is not disarmed, or another pulse is under way.
            BusyError: there is not enough memory.
        """
        if (state := self._state()) is not StationState.IDLE:
            raise StateError(f"The line is {state}.", action="Disarm it, then try settings.", code="line-armed")
        if self._bay is not None:
            raise StateError("Another pulse is under way.", action="Try again in a moment.", code="trial-running")
        if self._memory.available() < LEAST_BAYS:
            message = f"A trial needs {LEAST_BAYS} bays of the ring that may be used; one stays for the next board."
            raise BusyError(message, action="Release runs, end holds, or increase [ring] runs.", code="ring-full")
        self._count += 1
        run = f"trial-{self._count}"
        granted = self._memory.grant(run)
        if granted.evicted is not None:
            self._on_evicted(granted.evicted)
        self._bay, self._completion = granted.bay, completion
        grant = messages.Grant(run, granted.bay.number)
        self._acquisition.send(messages.FireTrial(grant, wanted.exposures, wanted.light, wanted.on_us))
        self._until_s = self._clock() + TRIAL_S

    def takes(self, report: messages.Report) -> bool:
        """Return whether a report belongs to a trial, and act on it."""
        run = getattr(report, "run", None)
        if run is None or self._bay is None or run != self._bay.run:
            return False
        if isinstance(report, messages.TrialFailed):
            self._fail(_error(report.why))
        elif isinstance(report, messages.RunFinished):
            completion, self._completion = self._completion, None
            if completion is None:
                self.release(run)  # the caller has given up
            else:
                completion.set_result(TrialShot(run, self._bay, report))
        return True

    def release(self, run: str) -> None:
        """Free the memory of a pulse whose frames were copied."""
        if self._bay is not None and self._bay.run == run:
            self._bay = None
        self._memory.free(run)

    def abandon(self, completion: Future[TrialShot]) -> None:
        """Let no caller wait for a pulse any more: its memory is free with its end, which may have come meanwhile."""
        if completion is self._completion:
            self._completion = None
        elif completion.done() and completion.exception() is None:
            self.release(completion.result().run)

    def end(self) -> None:
        """Set the exposures of station.toml again. A pulse under way still ends by itself."""
        if math.isfinite(self._until_s):
            self._until_s = math.inf
            self._acquisition.send(messages.EndTrial())

    def tick(self) -> None:
        """End a trial whose time is over, or that an armed line has ended. Arming that was refused has ended none."""
        if (state := self._state()) in _ARMED:
            self._until_s = math.inf
        elif state is StationState.IDLE and self._bay is None and self._clock() >= self._until_s:
            self.end()

    def acquisition_ended(self, description: str) -> None:
        """Take back the memory, and refuse the caller that waits: the process has ended."""
        self._until_s = math.inf
        self._fail(DeviceError(f"{description[:1].upper()}{description[1:]}.", action="Try again in a moment."))

    def _fail(self, error: VaoiError) -> None:
        bay, self._bay = self._bay, None
        completion, self._completion = self._completion, None
        if bay is not None and bay.run is not None:
            self._memory.free(bay.run)
        if completion is not None:
            completion.set_exception(error)


def _error(why: messages.Trouble) -> VaoiError:
    """Return the refusal of the acquisition process as an error of the same kind."""
    kind = {StateError.code: StateError, InputError.code: InputError}.get(why.code, DeviceError)
    return kind(f"{why.message[:1].upper()}{why.message[1:]}", action=why.action, code=why.code)


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


class Lighting:
    """Light programs and settings on trial, for callers in any thread but the coordinator's."""

    def __init__(
        self,
        config: StationConfig,
        px_per_mm: Sequence[float],
        ring: Ring,
        inbox: Inbox,
        trial: CameraTrial,
        devices: Callable[[], messages.Health | None],
    ) -> None:
        """Connect the parts. The thread of the inbox uses the trial, and calls `devices` for their latest report.

        `px_per_mm` is the resolution of every camera by its calibration; empty: nominal ones count.
        """
        self._config, self._ring, self._inbox, self._trial, self._devices = config, ring, inbox, trial, devices
        self.programs = LightPrograms(config, px_per_mm, lambda: inbox.ask(devices))

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
        health = self._inbox.ask(self._devices)
        # Beyond its stated limits the camera may take a value, and do something else.
        if health is not None and (limits := health.cameras[camera].limits) is not None:
            for fault in beyond_camera(exposures[camera], (gain_db,), limits, camera, own.label, ("trial", "")):
                raise fault.error
        light = wanted.light or next(iter(self._config.controller.light_sequence), "")
        on_us = wanted.on_us if wanted.on_us is not None or light not in known else known[light].on_us
        shot = self._fire(messages.FireTrial(messages.Grant("", 0), tuple(exposures), light, on_us))
        try:
            frame = next((f for f in shot.report.frames if f.camera == camera and f.slot is not None), None)
            if frame is None or frame.slot is None:
                missing = next((f.cause for f in shot.report.frames if f.camera == camera), "it never arrived")
                raise DeviceError(f"{own.label}: no frame ({missing}).", action="Check its cable and its trigger.")
            pixels = self._ring.snapshot(frame.slot, shot.bay.generation)
        finally:
            self._inbox.post(self._trial.release, shot.run)
        return TrialPicture(pixels, light, on_us, exposure_us, gain_db)

    def end_trial(self) -> None:
        """Set the exposures of station.toml again."""
        self._inbox.ask(self._trial.end)

    def _fire(self, wanted: messages.FireTrial) -> TrialShot:
        answer: Future[TrialShot] = Future()
        self._inbox.ask(self._trial.fire, wanted, answer)
        try:
            return self._inbox.wait(answer, lambda: None, SHOT_S)
        except TimeoutError:
            self._inbox.post(self._trial.abandon, answer)
            raise DeviceError(f"The pulse gave no frames within {SHOT_S:g} s.", action="Try again.") from None
        except StateError:
            # The refusal of a pulse has freed its memory; a station that stops has not.
            self._inbox.post(self._trial.abandon, answer)
            raise
