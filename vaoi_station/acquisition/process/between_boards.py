"""What cameras do between two boards: begin their sequences anew, and film one pulse on trial.

Every pulse leads a sequencer to its next set. To begin anew, the acquisition of a camera is stopped for milliseconds: a
pulse meanwhile is not answered, so that it is never done while pulses may be fired.
"""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections.abc import Callable, Sequence

from vaoi_station.acquisition.cameras.interface import CameraDevice, CameraExposure
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    ControllerEvent,
    PulseFired,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.process.messages import FireTrial, Grant, Report, TrialFailed, Trouble
from vaoi_station.acquisition.process.run_reports import trouble_report
from vaoi_station.acquisition.process.slot_queue import SlotQueue
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError, StateError

_log = logging.getLogger(__name__)

MARGIN_S = 0.005
"""Time, s, between the end of a rewind, which is expected to last as long as the one before, and the first pulse."""


class SequenceStart:
    """Follows the events of the controller, and rewinds each camera once after the pulses of a board."""

    def __init__(
        self, cameras: Sequence[CameraDevice], host_s: Callable[[float], float], send: Callable[[Report], None]
    ) -> None:
        self._cameras, self._host_s, self._send = cameras, host_s, send
        self._advanced: set[int] = set()
        """Cameras whose sequencer is not at its first set, because pulses were fired."""
        self._took_s = [0.0] * len(cameras)
        """Duration, s, that is expected of the next rewind of each camera: that of the latest one, or less."""
        self._late: set[int] = set()
        """Cameras that are reported as late, and have not begun their sequence anew in time since then."""
        self._delay_s = 0.0
        self._fires_from_s = math.inf
        """Host time from which on pulses may be fired; infinite while no board is in the barrier."""

    @property
    def board_comes(self) -> bool:
        """Whether a board is in the barrier, before its first pulse."""
        return math.isfinite(self._fires_from_s)

    def follow(self, event: ControllerEvent, plan: TriggerPlan | None) -> None:
        """Note what an event says of coming pulses. Events of a run that was given up are noted too."""
        if isinstance(event, BarrierBlocked):
            self._delay_s = plan.shortest_start_s if plan is not None else 0.0
            self._fires_from_s = self._host_s(event.time_s) + self._delay_s
        elif isinstance(event, PulseFired):
            if self._advanced and self._fires_from_s > -math.inf:
                self._report_late(self._advanced)
                self._expect_less()
            self._fires_from_s = -math.inf
            self._advanced = set(range(len(self._cameras)))
        elif isinstance(event, RunEnded):
            self._fires_from_s = math.inf

    def end_pulses(self) -> None:
        """Note that no pulse is fired any more, because the controller is disarmed."""
        self._fires_from_s = math.inf

    def is_due(self, now_s: float) -> bool:
        """Return whether a sequence has to begin anew, and no pulse may be fired yet."""
        return bool(self._advanced) and now_s < self._fires_from_s

    def rewind(self, now_s: float) -> None:
        """Rewind the cameras whose sequencers have advanced, as far as there is time before the next pulse."""
        began_s = time.monotonic()
        for number in sorted(self._advanced):
            at_s = now_s + time.monotonic() - began_s
            # A camera that does not answer delays this for seconds. Those after it would be stopped during a pulse.
            if at_s + self._took_s[number] + MARGIN_S < self._fires_from_s:
                self._cameras[number].rewind()
                ended_s = now_s + time.monotonic() - began_s
                self._took_s[number] = ended_s - at_s
                self._advanced.discard(number)
                if ended_s < self._fires_from_s:
                    self._late.discard(number)
                else:
                    self._report_late({number})

    def rewind_all(self) -> None:
        """Rewind all cameras, while the controller is disarmed."""
        self._fires_from_s = math.inf
        self._advanced = set(range(len(self._cameras)))
        self.rewind(0.0)

    def forget(self, camera: int) -> None:
        """Expect nothing of the next rewind of a camera, because it was opened anew."""
        self._took_s[camera] = 0.0

    def _expect_less(self) -> None:
        # Only a rewind is measured: one slow reply of a busy network would otherwise leave a camera out for ever.
        for number in self._advanced:
            if self._took_s[number] > self._delay_s / 2:
                self._took_s[number] /= 2

    def _report_late(self, cameras: set[int]) -> None:
        numbers = ", ".join(map(str, sorted(cameras)))
        _log.warning("pulses came before the sequence of exposures had begun anew in camera %s", numbers)
        if cameras <= self._late:
            return
        self._late |= cameras
        longest_s = max(self._took_s[number] for number in cameras)
        what = (
            f"camera {numbers}: its sequence of exposures did not begin anew before the first pulse of a board, whose "
            f"first frames may have the wrong exposure. Beginning anew took up to {longest_s:.2f} s; the first pulse "
            f"may come {self._delay_s:.2f} s after the edge of a board."
        )
        action = "Check its cable and the load of its network; if it comes again, use a longer start delay."
        self._send(trouble_report(DeviceError(what, action=action, code="sequence-late")))


UNREPORTED_S = 2.0


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
        self._unfired = self._unrestored = False
        """Whether its pulse is not reported yet; whether a camera may still have its settings although it is over."""
        self.until_s = math.inf
        """Time until which the controller must have reported the pulse; infinite if none is awaited."""

    @property
    def is_under_way(self) -> bool:
        """Whether a pulse is awaited, or frames of it."""
        return self._grant is not None

    def fire(self, trial: FireTrial, now_s: float) -> None:
        """Set the cameras, queue the slots of the trial and fire. If that is refused, its memory is not used."""
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
        """Set the exposures and gains of station.toml, unless the station is armed: its plan has set others."""
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
