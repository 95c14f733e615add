"""What the acquisition process knows between two messages: plan, grants, the run under way.

One thread uses it. Everything that can happen comes in as a call, with the time of day; reports go out by
`send`. Devices, ring and recorder are told in the order that keeps frames safe: memory before pulses.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

from vaoi_station.acquisition.cameras.interface import Arrival, CameraBack, CameraLost
from vaoi_station.acquisition.clocks import ClockModel
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    ControllerEvent,
    PulseFired,
    PulseSkipped,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.pairing.recorder import Finished, Outcome, Recorder, Stray
from vaoi_station.acquisition.pairing.run_sheet import RunSheet
from vaoi_station.acquisition.process.messages import (
    Armed,
    BoardMissed,
    Disarmed,
    FrameSettled,
    Grant,
    PulseReported,
    Report,
    RunStarted,
)
from vaoi_station.acquisition.process.run_reports import run_finished, trouble
from vaoi_station.acquisition.process.slot_queue import Magazine
from vaoi_station.acquisition.ring.ring import Ring
from vaoi_station.acquisition.ring.ring_layout import INCOMPLETE, OK
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, InputError, StateError
from vaoi_station.model import Verdict
from vaoi_station.optics.timing import spare_time_us

CLOCK_LIMIT_S = 2e-3
"""Clocks must be known this well before the station is armed ..."""
CLOCK_SHARE = 1 / 10
"""... and to this share of the period: which pulse a frame belongs to is decided by time."""
SILENCE_S = 10.0
"""A controller that has not ended a run so long after its longest duration has fallen silent."""

_STATES = {Verdict.OK: OK, Verdict.INCOMPLETE: INCOMPLETE}


class Session:
    """Grants, arming, and the runs one after another."""

    def __init__(
        self,
        config: StationConfig,
        ring: Ring,
        devices: Devices,
        controller_clock: ClockModel,
        camera_clocks: list[ClockModel],
        send: Callable[[Report], None],
    ) -> None:
        self._config, self._ring, self._devices, self._send = config, ring, devices, send
        self._clocks = [controller_clock, *camera_clocks]
        self._magazine = Magazine(ring, devices.cameras)
        exposures_us = [camera.exposure_us for camera in config.cameras]
        self._recorder = Recorder(controller_clock, camera_clocks, home=self._magazine.home, exposures_us=exposures_us)
        self._grants: deque[Grant] = deque()
        self._next: Grant | None = None
        """The grant whose slots the cameras hold for the next board."""
        self._plan: TriggerPlan | None = None
        self._run: RunSheet | None = None
        """The run whose pulses are being fired."""
        self._silent_s = float("inf")
        self._skipped: dict[int, str] = {}
        """Rows of a passage that were not fired, before the first one that was."""
        self._given_up = False
        """A run was closed before its end was told; what is still told of it comes too late."""
        self._edge_s = 0.0
        self._disarming = False

    def deadline_s(self, after_s: float) -> float:
        """The first time after `after_s` when `tick` has something to do; infinite if there is none."""
        times = (self._recorder.next_deadline_s(after_s), self._silent_s)
        return min(t for t in times if t is not None)

    def tick(self, now_s: float) -> None:
        """Deadlines."""
        if self._run is not None and now_s >= self._silent_s:
            error = DeviceError(
                f"the controller has not ended run {self._run.run}.",
                action="Check its cable and power, then arm again.",
            )
            self._send(trouble(error))
            self._end_run(self._run.rows, "the controller fell silent", now_s)
            self._given_up = True
        self._tell(self._recorder.settle(now_s), now_s)

    def grant(self, grant: Grant) -> None:
        """Memory for one more run."""
        self._grants.append(grant)
        self._load_next()

    def arm(self, plan: TriggerPlan) -> None:
        """Slots into the cameras, then the controller watches the barrier. Raises what forbids it."""
        if plan.max_rows > self._ring.layout.slots_per_camera:
            limit = f"at most the {self._ring.layout.slots_per_camera} slots per camera and run of the ring"
            raise InputError.field("trigger plan", "max_rows", plan.max_rows, limit)
        _require_time(plan, self._config)
        self._require_clocks(min(CLOCK_LIMIT_S, CLOCK_SHARE * plan.period_s))
        if plan != self._plan:
            if self._run is not None:
                raise StateError("a board is passing; the plan cannot change now.", action="Arm again in a moment.")
            if self._plan is not None:
                self._devices.controller.disarm()
            before, self._plan = self._plan, plan
            try:
                self._load_next()
                self._devices.controller.arm(plan)
            except BaseException:  # whatever ended it, tidy up; it is raised again
                self._plan = None if before is None else before
                raise
        self._send(Armed())

    def fire_one(self, now_s: float) -> None:
        """Slots into the cameras, then one pulse without the barrier. Raises what forbids it."""
        if self._plan is not None:
            raise StateError("boards are being filmed; single pulses would be among theirs.", action="Disarm first.")
        self._require_clocks(CLOCK_LIMIT_S)
        self._swap()
        if self._next is None:
            raise StateError("there is no memory for a pulse: all of it is in use.", action="Fire again in a moment.")
        self._edge_s = now_s
        self._devices.controller.fire_one()

    def disarmed(self, now_s: float) -> None:
        """The controller is disarmed and all its events have been read: finish, then give memory back."""
        if self._run is not None:
            self._end_run(self._run.rows, "disarmed", now_s)
        self._plan = None
        self._given_up = False
        self._disarming = True
        self._tell(self._recorder.settle(now_s), now_s)

    def heard(self, event: ControllerEvent, now_s: float) -> None:
        """The controller reports something."""
        self._recorder.heard(event.time_s)
        if self._comes_too_late(event):
            return
        if isinstance(event, BarrierBlocked):
            self._edge_s = min(self._clocks[0].host_s(event.time_s), now_s)
            self._skipped = {}
            self._swap()
        elif isinstance(event, PulseFired):
            if self._run is None or event.index <= max(self._run.pulses, default=-1):
                self._begin_run(now_s)
            pulse, outcomes = self._recorder.pulse(event, now_s)
            if self._run is not None and self._run.run is not None:
                self._send(PulseReported(self._run.run, pulse))
            self._tell(outcomes, now_s)
        elif isinstance(event, PulseSkipped):
            (self._skipped if self._run is None else self._run.skipped)[event.index] = event.reason
        elif isinstance(event, RunEnded):
            if self._run is None:
                self._send(BoardMissed(self._edge_s, f"no pulse was fired; the run ended with {event.reason!r}"))
            else:
                self._end_run(event.pulses, event.reason, now_s)

    def _require_clocks(self, limit_s: float) -> None:
        """ClockError while one is not known well enough; a camera that is away is read when it is back."""
        for number, clock in enumerate(self._clocks):
            if not self.is_away(number):
                clock.require(limit_s)

    def _comes_too_late(self, event: ControllerEvent) -> bool:
        """Whether it is of a run that has been given up; the next board, or that run's end, closes the matter."""
        late = self._given_up and not isinstance(event, BarrierBlocked)
        self._given_up = late and not isinstance(event, RunEnded)
        return late

    def arrived(self, arrival: Arrival, now_s: float) -> None:
        """A camera has finished with a slot."""
        self._magazine.came_back(arrival.slot)
        self._tell(self._recorder.arrive(arrival, now_s), now_s)

    def lost(self, news: CameraLost) -> None:
        """A camera is away; what it misses has that cause."""
        self._recorder.outages.lost(news.camera, news.since_s, news.why)

    def back(self, news: CameraBack) -> None:
        """A camera films again."""
        self._recorder.outages.back(news.camera, news.at_s)

    def is_away(self, number: int) -> bool:
        """Whether a device has been lost and is not back: never the controller (0), cameras are counted from 1."""
        return number > 0 and self._recorder.outages.away(number - 1)

    def _begin_run(self, now_s: float) -> None:
        """The first pulse of a passage."""
        if self._run is not None:
            self._end_run(self._run.rows, "the controller did not report its end", now_s)
            self._swap()
        plan = self._plan
        period_s = plan.period_s if plan else self._config.line.trigger_period_s
        rows = plan.max_rows if plan else self._ring.layout.slots_per_camera
        grant, self._next = self._next, None
        self._silent_s = now_s + rows * period_s + SILENCE_S
        if grant is None:
            self._run = self._recorder.begin(None, None, period_s)
            self._send(BoardMissed(self._edge_s, "no memory was granted for it: all of it is in use"))
        else:
            self._devices.feedback.memory(False)
            self._run = self._recorder.begin(grant.run, grant.bay, period_s)
            self._send(RunStarted(grant.run, grant.bay, self._edge_s))
        self._run.skipped, self._skipped = self._skipped, {}

    def _end_run(self, pulses: int, reason: str, now_s: float) -> None:
        assert self._run is not None
        sheet, self._run, self._silent_s = self._run, None, float("inf")
        self._tell(self._recorder.end(sheet, pulses, reason, now_s), now_s)
        self._load_next()

    def _tell(self, outcomes: Iterable[Outcome], now_s: float) -> None:
        """Carry out and report what the recorder has decided."""
        for outcome in outcomes:
            if isinstance(outcome, Stray):
                self._magazine.recycle(outcome.slot)
                self._devices.feedback.frame_done()
            elif isinstance(outcome, Finished):
                self._finish(outcome, now_s)
            else:
                frame = outcome.frame
                if frame.slot is not None:
                    self._ring.note(frame.slot, _STATES[frame.verdict], frame.row, frame.frame_id)
                self._send(FrameSettled(outcome.run, frame, now_s))
                if frame.slot is not None:
                    self._devices.feedback.frame_done()
        if self._disarming and not self._recorder.open_runs:
            self._give_back()

    def _finish(self, finished: Finished, now_s: float) -> None:
        """The bay's slots out of the cameras before the station may give it away."""
        bay = finished.sheet.bay
        assert bay is not None
        if self._magazine.loaded == bay:
            self._magazine.unload()
        self._magazine.close_run(bay)
        self._send(run_finished(self._config, finished, now_s))
        self._load_next()

    def _swap(self) -> None:
        """Pulses come while the last run waits for late frames: the next one's slots must be in the cameras."""
        if self._run is None and self._next is None and self._grants:
            self._magazine.unload()
            self._load()

    def _load_next(self) -> None:
        """Queue the next grant's slots while armed, unless cameras still need those of another run."""
        if self._plan is not None and self._run is None and self._magazine.loaded is None and self._grants:
            self._load()

    def _load(self) -> None:
        self._next = self._grants.popleft()
        self._magazine.load(self._next.bay)
        self._devices.feedback.memory(True)

    def _give_back(self) -> None:
        """Everything that was granted and not used."""
        self._disarming = False
        self._devices.feedback.memory(False)
        self._magazine.unload()
        unused = ([self._next] if self._next else []) + list(self._grants)
        for grant in unused:
            self._magazine.close_run(grant.bay)
        self._next = None
        self._grants.clear()
        self._send(Disarmed(tuple(unused)))


def _require_time(plan: TriggerPlan, config: StationConfig) -> None:
    """InputError for a period in which a camera cannot expose and read out."""
    for camera in config.cameras:
        if spare_time_us(plan.period_s * 1e6, camera.exposure_us, camera.readout_us) < 0:
            needed_s = (camera.exposure_us + camera.readout_us) * 1e-6
            limit = (
                f"at least {needed_s:g}: camera {camera.name!r} exposes for {camera.exposure_us:g} µs "
                f"and is read out in {camera.readout_us:g} µs"
            )
            raise InputError.field("trigger plan", "period_s", plan.period_s, limit)
