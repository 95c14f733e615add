"""The state of the acquisition process: the trigger plan, the grants, and the run under way.

Only one thread uses the session. Every event is a method call with the host time; reports go out through `send`. The
order of actions on devices, ring and recorder keeps frames safe: the cameras hold slots before a pulse is fired.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable

from vaoi_station.acquisition.cameras.interface import Arrival, is_silent
from vaoi_station.acquisition.clocks import ClockModel
from vaoi_station.acquisition.controller.announced import AnnouncedBoards
from vaoi_station.acquisition.controller.filming_plan import exposures_of, link_faults, require_none, time_faults
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    ControllerEvent,
    PulseFired,
    PulseSkipped,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.pairing.conclusion import Outages
from vaoi_station.acquisition.pairing.latency import LatencySettings
from vaoi_station.acquisition.pairing.recorder import Finished, Outcome, Recorder, Unassigned
from vaoi_station.acquisition.pairing.run_record import RunRecord
from vaoi_station.acquisition.process.between_boards import SequenceStart, TrialPulse
from vaoi_station.acquisition.process.messages import (
    Armed,
    BoardMissed,
    Disarmed,
    FireTrial,
    FrameSettled,
    Grant,
    MissedPassage,
    PulseReported,
    Report,
    RunStarted,
)
from vaoi_station.acquisition.process.passages import Passages
from vaoi_station.acquisition.process.run_reports import finished_report, trouble_report
from vaoi_station.acquisition.process.slot_queue import SlotQueue
from vaoi_station.acquisition.ring import INCOMPLETE, OK, Ring
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, InputError, StateError, VaoiError
from vaoi_station.model import Pulse, Verdict
from vaoi_station.model.recording import linear_gain

CLOCK_LIMIT_S = 2e-3
"""Arming requires that the error bound of every clock is at most this (s), and at most `CLOCK_SHARE` of the period."""
CLOCK_SHARE = 1 / 10
"""Largest error bound of a clock as a share of the trigger period, because frames are assigned to pulses by time."""
SILENCE_S = 10.0
"""After the longest duration of a run, the session waits this long, s, for the controller to report the run's end."""

_STATES = {Verdict.OK: OK, Verdict.INCOMPLETE: INCOMPLETE}


class Session:
    """Makes the decisions of the acquisition process: uses the granted memory, arms the controller, films runs."""

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
        self._slot_queue = SlotQueue(ring, devices.cameras)
        self.sequences = SequenceStart(devices.cameras, controller_clock.host_s, send)
        exposures_us = [camera.exposure_us for camera in config.cameras]
        self._recorder = Recorder(
            controller_clock,
            camera_clocks,
            move_to_bay=self._slot_queue.move_to_bay,
            exposures_us=exposures_us,
            latencies=[LatencySettings.of(camera) for camera in config.cameras],
            gains=[linear_gain(camera.gain_db) for camera in config.cameras],
        )
        self._grants: deque[Grant] = deque()
        self._next: Grant | None = None
        """The grant whose slots the cameras hold for the next board."""
        self.plan: TriggerPlan | None = None
        self._run: RunRecord | None = None
        self._silent_s = math.inf
        self._skipped: dict[int, PulseSkipped] = {}
        """Reports of the rows that were skipped before the first pulse of a board."""
        self._outdated_until_s = -math.inf
        """Host time before which events are outdated: they belong to a run or pulse that was given up."""
        self._passages = Passages(controller_clock)
        self.announced = AnnouncedBoards(config.line.transport_s[1], wired=config.smema is not None)
        self._disarming = False
        self.trial = TrialPulse(config.cameras, devices, self._slot_queue, lambda: self.plan is not None)

    @property
    def filming(self) -> bool:
        """Whether a board is being filmed as a run. Pulses of a board for which no bay was free belong to no run."""
        return self._run is not None and self._run.run is not None

    def note_serial(self, camera: int, serial: str) -> None:
        """State from now on in the recordings of runs that another camera has this place."""
        self._config = self._config.with_serial(camera, serial)

    def deadline_s(self, after_s: float) -> float:
        """Return the first time after `after_s` at which `tick` has something to do; infinite if there is none."""
        times = (self._recorder.next_deadline_s(after_s), self._silent_s, self.trial.until_s)
        return min(t for t in times if t is not None)

    def tick(self, now_s: float) -> None:
        """Carry out all actions whose time has come."""
        if self._run is not None and now_s >= self._silent_s:
            what = f"the controller has not reported the end of run {self._run.run}."
            self._send(trouble_report(DeviceError(what, action="Check its cable and power, then arm again.")))
            self._end_run(self._run.rows, "the controller stopped reporting", now_s)
            self._outdated_until_s = math.inf
        if (failed := self.trial.overdue(now_s)) is not None:
            self._outdated_until_s = math.inf
            self._send(failed)
        self._apply(self._recorder.settle(now_s), now_s)

    def rewind_sequences(self, now_s: float) -> None:
        """Let the sequencers of the cameras begin anew for the next board. Call it when all events are handled."""
        # Frames that are awaited are not put at risk, unless the next board is in the barrier already.
        awaited = (run.awaits_frames(len(self._devices.cameras)) for run in self._recorder.open_runs)
        if self.sequences.is_due(now_s) and (self.sequences.board_comes or not any(awaited)):
            self.sequences.rewind(now_s)

    def grant(self, grant: Grant) -> None:
        """Accept the grant of a bay for one more run."""
        self._grants.append(grant)
        self._load_next()

    def arm(self, plan: TriggerPlan) -> None:
        """Queue slots in the cameras, then let the controller watch the barrier.

        A plan that is refused leaves the present one in force, unless the controller failed: then none is.
        """
        if plan.max_rows > self._ring.layout.slots_per_camera:
            limit = f"at most the {self._ring.layout.slots_per_camera} slots per camera and run of the ring"
            raise InputError.field("trigger plan", "max_rows", plan.max_rows, limit)
        limits = [limits for camera in self._devices.cameras if (limits := camera.health().limits) is not None]
        row_s = max((stated.row_s for stated in limits if stated.row_s is not None), default=None)
        require_none([*time_faults(plan, self._config), *link_faults(plan, row_s)])
        self._require_clocks(min(CLOCK_LIMIT_S, CLOCK_SHARE * plan.period_s))
        if plan != self.plan:
            if self._run is not None:
                raise StateError("a board is passing; the plan cannot change now.", action="Arm again in a moment.")
            before, self.plan = self.plan, None
            try:
                if before is not None:
                    self._devices.controller.disarm()
                # Slots are queued only with a plan set, and before the controller may fire.
                self.plan = plan
                self._load_next()
                for camera, wanted in zip(self._devices.cameras, exposures_of(plan, self._config), strict=True):
                    camera.set_exposure(wanted)
                self.sequences.rewind_all()
                self._devices.controller.arm(plan)
            except BaseException as error:  # after any failure the station is not armed; raised again
                # The controller has already given up its previous plan. If it stayed here, it would count as armed.
                self.plan = None
                if isinstance(error, VaoiError) and before is not None:
                    message = f"the station is not armed: its plan could not be changed: {error.message}"
                    raise type(error)(message, action=error.action, code=error.code) from error
                raise
        self._send(Armed())

    def fire_one(self, now_s: float) -> None:
        """Queue slots in the cameras, then fire one pulse without the barrier."""
        if self.plan is not None:
            raise StateError(
                "the station is armed; single pulses would mix with those of boards.", action="Disarm first."
            )
        self._require_clocks(CLOCK_LIMIT_S)
        self._load_while_waiting()
        if self._next is None:
            raise StateError(
                "there is no memory for a pulse: all bays of the ring are in use.", action="Fire again in a moment."
            )
        self.sequences.rewind(now_s)
        self._devices.controller.fire_one()
        self._expect_pulse(now_s)

    def fire_trial(self, trial: FireTrial, now_s: float) -> None:
        """Fire one pulse with the settings of a trial, into the memory that it brings; raises as `TrialPulse.fire`."""
        self._require_clocks(CLOCK_LIMIT_S)
        self.trial.fire(trial, now_s)
        # Not before: a trial that is refused leaves the passage of a board as it is. Its pulse is not handled yet.
        self._expect_pulse(now_s)

    def finish_disarming(self, now_s: float) -> None:
        """End the run under way, when the controller is disarmed and all its events are handled; return the grants."""
        if self._run is not None:
            self._end_run(self._run.rows, "disarmed", now_s)
        self.plan = None
        self.sequences.end_pulses()
        # While disarmed, no edge is reported. So at the next arming it is not known what is in the barrier.
        self._passages.forget()
        self._outdated_until_s = -math.inf
        self._disarming = True
        self._apply(self._recorder.settle(now_s), now_s)

    def handle_event(self, event: ControllerEvent, now_s: float) -> None:
        """Record an event of the controller (barrier, pulse, end of a run) in the run to which it belongs."""
        self._recorder.note_controller_time(event.time_s)
        self.announced.follow(event)
        self.sequences.follow(event, self.plan)
        if self._is_outdated(event):
            return
        if isinstance(event, PulseFired):
            # An index that does not grow belongs to the next board: the report of the previous run's end was lost.
            if self._run is None or event.index <= max(self._run.pulses, default=-1):
                self._begin_run(now_s)
            outcomes = self._recorder.add_pulse(event, now_s)
            if self._run is not None and self._run.run is not None:
                pulse = Pulse(index=event.index, time_s=event.time_s, light=event.light)
                self._send(PulseReported(self._run.run, pulse))
            self._apply(outcomes, now_s)
        elif isinstance(event, PulseSkipped):
            (self._skipped if self._run is None else self._run.skipped)[event.index] = event
        elif isinstance(event, RunEnded):
            if self._run is None:
                self._passages.over = True
                self._send(
                    BoardMissed(self._passages.edge_s, f"no pulse was fired; the run ended with {event.reason!r}")
                )
            else:
                self._end_run(event.pulses, event.reason, now_s)
        else:
            if (missed := self._passages.add(event, now_s)) is not None:
                self._send(missed)
            if isinstance(event, BarrierBlocked):
                self._skipped = {}
                # During the start delay, slots are queued for the first pulse.
                self._load_while_waiting()

    def _expect_pulse(self, now_s: float) -> None:
        """Use the events of a pulse that was fired just now; those before it stay outdated."""
        self._passages.begin_single(now_s)
        self._outdated_until_s = min(self._outdated_until_s, now_s - CLOCK_LIMIT_S)

    def _is_outdated(self, event: ControllerEvent) -> bool:
        """Return whether an event is outdated. The end of a run, the next board or a later event ends this."""
        if self._outdated_until_s == -math.inf:
            return False
        late = not isinstance(event, BarrierBlocked) and self._clocks[0].host_s(event.time_s) < self._outdated_until_s
        if not late or isinstance(event, RunEnded):
            self._outdated_until_s = -math.inf
        return late

    def _require_clocks(self, limit_s: float) -> None:
        for number, clock in enumerate(self._clocks):
            if not self.is_away(number):
                clock.require(limit_s)

    def handle_arrival(self, arrival: Arrival, now_s: float, taken_until_s: float) -> None:
        """Assign a frame, delivered by a camera in a slot, to its run and pulse. Later frames may wait in the inbox."""
        self._slot_queue.mark_returned(arrival.slot)
        self._apply(self._recorder.add_arrival(arrival, taken_until_s), now_s)

    @property
    def outages(self) -> Outages:
        """The outages of the cameras and the jumps of their clocks, which are the causes of missing frames."""
        return self._recorder.outages

    @property
    def awaits_clocks(self) -> bool:
        """Whether a run waits for its end, so that all clocks should be read at once."""
        return self._recorder.awaits_clocks

    def is_away(self, number: int) -> bool:
        """Whether a device was lost and is not back; cameras count from 1, the controller (0) is never away."""
        return number > 0 and self._recorder.outages.is_away(number - 1)

    def _begin_run(self, now_s: float) -> None:
        if self._run is not None:
            self._end_run(self._run.rows, "the controller did not report its end", now_s)
            self._load_while_waiting()
        plan = self.plan
        period_s = plan.period_s if plan else self._config.line.trigger_period_s
        rows = plan.max_rows if plan else self._ring.layout.slots_per_camera
        grant, self._next = self.trial.take() or self._next, None
        known = self._passages.edge_known
        edge_s = self._passages.edge_s if known else now_s
        self._silent_s = now_s + rows * (plan.longest_period_s if plan else period_s) + SILENCE_S
        if grant is None:
            self._run = self._recorder.begin_run(None, None, period_s)
            reason = "no memory was free for its frames: all bays of the ring are in use"
            self._send(BoardMissed(edge_s, reason))
        else:
            self._devices.feedback.set_memory(False)
            self._run = self._recorder.begin_run(grant.run, grant.bay, period_s)
            came = None if plan is None else self.announced.take_came()
            self._send(RunStarted(grant.run, grant.bay, edge_s, known, came))
        self._run.skipped, self._skipped = self._skipped, {}
        if plan is not None:
            self._run.program, self._run.conveyor_mm_s = plan.program, plan.conveyor_mm_s
            self._run.row_mm, self._run.fastest_s = plan.row_mm, plan.shortest_period_s
        # This is the same list, not a copy: it grows until the end of the run.
        self._run.interruptions = self._passages.begin_run()

    def _end_run(self, pulses: int, reason: str, now_s: float) -> None:
        assert self._run is not None
        record, self._run, self._silent_s = self._run, None, math.inf
        record.silent = frozenset(k for k, c in enumerate(self._devices.cameras) if is_silent(c.health()))
        # From here on, the passage is that of what is still in the barrier: the run keeps the interruptions until now.
        passages, interruptions = self._passages, tuple(record.interruptions)
        is_latest = record.interruptions is passages.interruptions
        passages.over = passages.over or is_latest
        record.interruptions = list(interruptions)
        if record.run is None:
            encoder, zero_s = self._config.line.encoder, interruptions[0][0] if interruptions else 0.0
            ways_mm = passages.ways_mm(encoder.counts_per_mm) if encoder is not None and is_latest else None
            since_first = tuple((b - zero_s, None if c is None else c - zero_s) for b, c in interruptions)
            self._send(MissedPassage(passages.edge_s, since_first, ways_mm))
        self._apply(self._recorder.end_pulses(record, pulses, reason, now_s), now_s)
        self._load_next()

    def _apply(self, outcomes: Iterable[Outcome], now_s: float) -> None:
        for outcome in outcomes:
            if isinstance(outcome, Unassigned):
                self._slot_queue.recycle(outcome.slot)
                self._devices.feedback.frame_done()
            elif isinstance(outcome, Finished):
                self._finish(outcome, now_s)
            else:
                frame = outcome.frame
                # The slot table is written before the report: readers of the ring look the frame up after the report.
                if frame.slot is not None:
                    self._ring.write_slot_record(frame.slot, _STATES[frame.verdict], frame.row, frame.frame_id)
                self._send(FrameSettled(outcome.run, frame, now_s))
                if frame.slot is not None:
                    self._devices.feedback.frame_done()
        if self._disarming and not self._recorder.open_runs:
            self._return_grants()

    def _report_silence(self, record: RunRecord) -> None:
        """Tell the cameras of which nothing came of a run. If none sent anything, the trigger is the likelier cause."""
        cameras = range(len(self._devices.cameras))
        sent, rows = {camera for camera, _ in record.taken}, sorted(record.pulses)
        if len(rows) < 2 or not (sent or len(cameras) == 1):
            return
        times_s = record.pulses[rows[0]].host_s, record.pulses[rows[-1]].host_s
        for camera in cameras:
            # One outage after the other may cover a run; the first and the last row are enough to see that.
            if camera not in sent and not any(self.outages.cause_at(camera, time_s) for time_s in times_s):
                self._devices.cameras[camera].sent_nothing(len(rows), times_s[0])

    def _finish(self, finished: Finished, now_s: float) -> None:
        self._report_silence(finished.record)
        self.trial.finish(finished.record.run)
        bay = finished.record.bay
        assert bay is not None
        # The slots are taken back first: after the report the station may give the bay to another board.
        if self._slot_queue.loaded == bay:
            self._slot_queue.unload()
        self._slot_queue.close_bay(bay)
        self._send(finished_report(self._config, finished, now_s))
        self._load_next()

    def _load_while_waiting(self) -> None:
        """Queue the slots of the next grant. If a run only awaits late frames, take its slots back first."""
        if self._run is None and self._next is None and self._grants:
            self._slot_queue.unload()
            self._load()

    def _load_next(self) -> None:
        """Queue the slots of the next grant if a plan is set and the cameras hold no slots of another run."""
        if self.plan is not None and self._run is None and self._slot_queue.loaded is None and self._grants:
            self._load()

    def _load(self) -> None:
        self._next = self._grants.popleft()
        self._slot_queue.load(self._next.bay)
        self._devices.feedback.set_memory(True)

    def _return_grants(self) -> None:
        self._disarming = False
        self._devices.feedback.set_memory(False)
        self._slot_queue.unload()
        unused = ([self._next] if self._next else []) + list(self._grants)
        for grant in unused:
            self._slot_queue.close_bay(grant.bay)
        self._next = None
        self._grants.clear()
        self._send(Disarmed(tuple(unused)))
