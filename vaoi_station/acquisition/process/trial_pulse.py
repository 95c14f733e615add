"""One pulse with settings on trial, while the station is disarmed: from the command to its last frame.

Its memory comes with the command and is used for nothing else. Arming waits until the pulse is over, so that the first
board finds the cameras with its own memory and its own exposures.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence

from vaoi_station.acquisition.cameras.interface import CameraExposure
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.process.messages import FireTrial, Grant, TrialFailed, Trouble
from vaoi_station.acquisition.process.slot_queue import SlotQueue
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError, StateError

UNREPORTED_S = 2.0
"""Longest wait for the controller's report of the pulse, s."""


class TrialPulse:
    """The trial under way, if there is one. Used by the session only."""

    def __init__(
        self,
        cameras: Sequence[CameraConfig],
        devices: Devices,
        slot_queue: SlotQueue,
        is_armed: Callable[[], bool],
    ) -> None:
        self._cameras, self._devices, self._slot_queue, self._is_armed = cameras, devices, slot_queue, is_armed
        self._grant: Grant | None = None
        self._unfired = False
        self._unrestored = False
        """Whether a camera may have the settings of a trial although those of station.toml were to be set."""
        self.until_s = math.inf
        """Time until which the controller must have reported the pulse; infinite if none is awaited."""

    @property
    def is_under_way(self) -> bool:
        """Whether a pulse is awaited, or frames of it."""
        return self._grant is not None

    def fire(self, trial: FireTrial, now_s: float) -> None:
        """Set the cameras, queue the slots of the trial and fire. If that is refused, its memory is not used.

        Raises:
            StateError: the station is armed, another pulse is under way, or the controller cannot fire now.
            DeviceError: a camera or the controller refuses the settings.
            InputError: the controller cannot light the LEDs so.
        """
        if self._is_armed():
            raise StateError("the station is armed; a trial would disturb its boards.", action="Disarm first.")
        # The cameras fill slots in their order: those of another run must not come first.
        if self.is_under_way or self._slot_queue.loaded is not None:
            raise StateError("a pulse is under way.", action="Fire again in a moment.")
        try:
            for camera, wanted in zip(self._devices.cameras, trial.exposures, strict=True):
                camera.set_exposure(wanted)
        except DeviceError:
            with contextlib.suppress(DeviceError):  # the first error says what is wrong
                self.restore()
            raise
        self._unrestored = False
        self._grant, self._unfired, self.until_s = trial.grant, True, now_s + UNREPORTED_S
        self._slot_queue.load(trial.grant.bay)
        try:
            self._devices.controller.fire_one(trial.light, trial.on_us)
        except BaseException:  # after any failure the memory must be free again; raised again
            self._give_up()
            raise

    def take(self) -> Grant | None:
        """Return the memory for the pulse that was reported just now; None if it is no trial's."""
        if not self._unfired:
            return None
        self._unfired, self.until_s = False, math.inf
        return self._grant

    def finish(self, run: str | None) -> None:
        """Record that a run has all its frames, or will not get them any more."""
        if self._grant is not None and self._grant.run == run:
            self._grant = None

    def overdue(self, now_s: float) -> TrialFailed | None:
        """Give up a pulse that the controller has not reported in time; return the report of it."""
        if self._grant is None or now_s < self.until_s:
            return None
        run = self._grant.run
        self._give_up()
        why = "The controller did not report the pulse."
        return TrialFailed(run, Trouble(DeviceError.code, why, "Check its cable and power."))

    def restore(self) -> None:
        """Set the exposures and gains of station.toml, unless the station is armed: its plan has set others.

        Raises:
            DeviceError: a camera did not take them. All others have them; it gets them when a camera is back.
        """
        self._unrestored = False
        if self._is_armed():
            return
        refusals: list[DeviceError] = []
        for camera, own in zip(self._devices.cameras, self._cameras, strict=True):
            try:
                camera.set_exposure(CameraExposure((own.exposure_us,), own.gain_db))
            except DeviceError as error:
                refusals.append(error)
        if refusals:
            self._unrestored = True
            raise refusals[0]

    def camera_back(self) -> None:
        """Try `restore` again if a camera did not take its settings: one that was going away has those of the trial."""
        if self._unrestored and not self.is_under_way:
            self.restore()

    def _give_up(self) -> None:
        assert self._grant is not None
        self._slot_queue.unload()
        self._slot_queue.close_bay(self._grant.bay)
        self._grant, self._unfired, self.until_s = None, False, math.inf
