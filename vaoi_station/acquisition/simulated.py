"""The digital twin in place of line, cameras and controller."""

from __future__ import annotations

import math
import random
import threading
import time
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.cameras.interface import CameraExposure, DeviceFault
from vaoi_station.acquisition.cameras.virtual import Exposure, VirtualCamera
from vaoi_station.acquisition.clocks import ClockReading, DeviceClock, simulated_clock
from vaoi_station.acquisition.controller.filming_plan import filming_plan, require_none, unknown_lights
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BoardOffer,
    Contacts,
    ContactsChanged,
    Controller,
    ControllerEvent,
    ControllerLimits,
    EventQueue,
    LineOutput,
    Permit,
    PulseFired,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.controller.trigger_rule import BeltCounter, TriggerRule
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.pairing.evidence import MAX_FRAME_ID
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError, InternalError, StateError, VaoiError
from vaoi_station.line_config import Smema
from vaoi_station.model.recording import linear_gain, row_of
from vaoi_station.simulation import Passage, Scenario, Twin, calibration_board, read_scenario
from vaoi_station.simulation.board.kept_artwork import kept_or_drawn
from vaoi_station.supervised_thread import DEVICE_LIMIT_S, SupervisedThread

READOUT_S = 0.008
TRANSFER_S = 0.012
JITTER_S = 0.002
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
        """Expose one frame at a host time."""
        # Ids count from 1 to 65535 and then from 1 again, as those of GigE Vision.
        frame_id, self._id = (self._id - 1 + id_error) % MAX_FRAME_ID + 1, self._id % MAX_FRAME_ID + 1
        if lost:
            return
        latency_s = TRIGGER_LATENCY_S + self._random.uniform(0, TRIGGER_JITTER_S)
        stamp_s = self._clock.device_s(host_s + stamp_error_s + latency_s)
        begin_s = host_s + self._exposure_s + READOUT_S + self._random.uniform(0, JITTER_S) + late_s
        self.expose(Exposure(frame_id, stamp_s, begin_s, begin_s + TRANSFER_S, pixels, share))


FAR_S = 1e4


class SimulatedBoard:
    """A board with its barrier edges, pulses and frames. All times are seconds since the start of its passage."""

    def __init__(self, passage: Passage, plan: TriggerPlan, cameras: int) -> None:
        self.passage = passage
        self.edges = barrier_edges(passage)
        self.pulses = predict_pulses(self.edges, plan, passage.encoder)
        self._program = plan.program
        self._to_render = [(c, r) for r in range(len(self.pulses)) for c in range(cameras)]
        self._frames: dict[tuple[int, int], NDArray[np.uint8]] = {}

    @property
    def ready(self) -> bool:
        """Whether all frames of the board are rendered."""
        return not self._to_render

    def render_one(self) -> None:
        """Render the next frame of the board that is not rendered yet."""
        camera, row = self._to_render.pop(0)
        pulse = self.pulses[row]
        filmed = row_of(self._program, row)
        image = self.passage.frame_at(camera, pulse.time_s, pulse.light, row, filmed)
        self._frames[camera, row] = to_bytes(image)

    def pixels(self, camera: int, row: int) -> NDArray[np.uint8]:
        """Return the flat bytes of a frame. A stuck board may have more rows than frames: the last one is repeated."""
        return self._frames[camera, min(row, len(self.pulses) - 1)]


def to_bytes(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return a frame (height, width) as the flat bytes that a camera sends."""
    return np.ascontiguousarray(image).reshape(-1).view(np.uint8)


def barrier_edges(passage: Passage) -> list[tuple[float, bool]]:
    """Return every change of the barrier as (time, whether it is interrupted then); bounces invert the true state."""
    toggles = [passage.blocked_s, passage.clear_s]
    for bounce in passage.faults.bounces:
        toggles += [bounce.at_s, bounce.at_s + bounce.duration_s]
    # A board that is stuck never clears the barrier: its time is infinite and gives no edge.
    finite = sorted(t for t in toggles if math.isfinite(t))
    return [(0.0, False), *((t, n % 2 == 0) for n, t in enumerate(finite))]


def predict_pulses(
    edges: list[tuple[float, bool]], plan: TriggerPlan, belt: BeltCounter | None = None
) -> list[PulseFired]:
    """Return the pulses that the controller will fire for these edges of the barrier, and this way of the belt."""
    rule = TriggerRule(plan, count(), belt)
    events: list[ControllerEvent] = []
    for time_s, blocked in edges:
        events += rule.advance(time_s)
        rule.add_edge(time_s, blocked)
    events += rule.advance(FAR_S)
    return [e for e in events if isinstance(e, PulseFired)]


def accept_plan(asked: TriggerPlan, expected: TriggerPlan, lights: Collection[str] = ()) -> TriggerPlan:
    """Return the requested plan, without a light program with the lights and the program of the scenario."""
    for key in ("start_delay_s", "period_s", "tail_s", "debounce_s"):
        value, must = getattr(asked, key), getattr(expected, key)
        if not math.isclose(value, must, rel_tol=1e-9, abs_tol=1e-12):
            raise InputError.field("trigger plan", key, value, f"{must}, as in the scenario", "Adapt [line].")
    if asked.belt != expected.belt:
        raise InputError.field(
            "trigger plan", "belt", asked.belt, f"{expected.belt}, as in the scenario", "Adapt [line]."
        )
    require_none(unknown_lights(asked.program, lights))
    if asked.program:
        return asked
    if asked.lights and tuple(asked.lights) != tuple(expected.lights):
        limit = f"{tuple(expected.lights)}, as in the scenario"
        raise InputError.field("trigger plan", "lights", tuple(asked.lights), limit)
    return replace(asked, lights=tuple(expected.lights), program=expected.program)


AHEAD = 2
LEAD_S = 0.02
RENDER_LIMIT_S = 600.0
"""Longest time for one frame of the twin, s. The first one may wait for the compiler on a busy computer."""
SAME_TIME_S = 1e-6


class SimulatedController(Controller):
    """The simulated conveyor with its controller: boards pass, a `TriggerRule` fires, and the cameras expose.

    One thread follows the rule; another one renders boards ahead and lets them pass. Both hold `_change` when they
    change anything.
    """

    def __init__(
        self,
        twin: Twin,
        cameras: tuple[SimulatedCamera, ...],
        boards: int,
        interval_s: float,
        interlock: bool = False,
        smema: Smema | None = None,
    ) -> None:
        """Prepare to let `boards` boards pass, any number if it is 0, at least `interval_s` apart."""
        self._twin, self._cameras, self._clock = twin, cameras, simulated_clock(-1)
        self._scenario_plan = self._plan = scenario_plan(twin)
        self._boards, self._interval_s, self._interlock = boards, interval_s, interlock
        self._smema = smema
        self._offer: BoardOffer | None = None
        self._offered_s = -math.inf
        self._taken = 0
        self._reported: Contacts | None = None
        self._permit: Permit | None = None
        self._spent: int | None = None
        self._change = threading.Condition()
        self._numbers = count()
        self._edges: deque[tuple[float, bool]] = deque()
        """Coming changes of the barrier by the controller's clock, and whether it is interrupted from then on."""
        self._rule: TriggerRule | None = None
        self._ready: deque[SimulatedBoard] = deque()
        self._prepared = self._runs = 0
        self._board: SimulatedBoard | None = None
        """The latest board that passes or has passed; its passage began at `_start_s` by the controller's clock."""
        self._start_s = 0.0
        self._still: list[NDArray[np.uint8]] = []
        """Flat bytes of every camera's frame of the calibration board; rendered with the first pulse that shows it."""
        self._next_host_s = -math.inf
        self._passing = self._closing = False
        self._threads = (
            SupervisedThread(self._follow_rule, "controller", DEVICE_LIMIT_S),
            SupervisedThread(self._let_boards_pass, "line", RENDER_LIMIT_S),
        )

    def start(self, events: EventQueue) -> None:
        """Begin to prepare boards, and to put events and faults into the queue `events`."""
        self._events = events
        for thread in self._threads:
            thread.start()

    def arm(self, plan: TriggerPlan) -> None:
        """Film every board from now on with this plan; `accept_plan` states which plans are refused."""
        plan = accept_plan(plan, self._scenario_plan, self._twin.scenario.lights)
        rule = TriggerRule(plan, self._numbers, self)
        with self._change:
            if plan.program != self._plan.program:
                self._prepared -= len(self._ready)
                self._ready.clear()
            self._plan, self._rule = plan, rule
            # Edges of a board that entered before belong to no run of this arming.
            self._edges.clear()
            self._change.notify_all()

    def disarm(self) -> None:
        """Ignore the barrier from now on and end a run under way."""
        with self._change:
            if self._rule is not None:
                self._report(self._rule.stop(self._clock.now_s()))
            self._rule, self._passing = None, False
            self._edges.clear()
            self._change.notify_all()

    def fire_one(self, light: str = "", on_us: float | None = None) -> None:
        """Fire one pulse now: the cameras show the calibration board at rest."""
        with self._change:
            if self._rule is not None:
                raise StateError("the controller is armed: its pulses belong to boards.", action="Disarm, then fire.")
            pulse = PulseFired(next(self._numbers), self._clock.now_s(), 0, light, on_us=on_us)
            if not self._still:
                self._still = [to_bytes(image) for _, _, image in calibration_board.frames(self._twin)]
            host_s = self._clock.host_s(pulse.time_s)
            for camera, pixels in zip(self._cameras, self._still, strict=True):
                camera.trigger(host_s, self._exposed(pixels, camera.brightness(on_us)))
            self._events.put(pulse)
            self._events.put(RunEnded(next(self._numbers), pulse.time_s, 1, "single"))

    def read_clock(self) -> ClockReading:
        """Compare the controller's clock with the host's."""
        return self._clock.read()

    def permit_board(self, permit: Permit | None) -> None:
        """Let one board enter the belt while the permit is valid, if the conveyor obeys the interlock."""
        with self._change:
            self._permit = permit
            self._change.notify_all()

    def line_output(self) -> LineOutput | None:
        """Return whether a board may enter now; None if the conveyor does not obey the interlock."""
        if not self._interlock:
            return None
        if self._rule is None or self._passing:
            return LineOutput(False, "the controller is not armed, or a board is being filmed")
        return LineOutput(True) if self._permitted() else LineOutput(False, "the station does not permit a board")

    def offer_board(self, offer: BoardOffer | None) -> None:
        """Offer a board to a next machine that takes each one after the shortest exit time."""
        with self._change:
            if offer is None or self._offer is None or offer.number != self._offer.number:
                self._offered_s = time.monotonic()
            self._offer = offer

    def contacts(self) -> Contacts | None:
        """Return the contacts of the simulated neighbours, whose boards are never failed ones."""
        if self._smema is None:
            return None
        offer, both = self._offer, self._smema.sides == "both"
        if offer is not None and time.monotonic() - self._offered_s > offer.exit_s[0]:
            self._taken = offer.number
        offered = offer is not None and offer.number != self._taken
        failed = offered and offer is not None and offer.failed
        available = not self._passing and any(board.ready for board in [*self._ready][:1])
        return Contacts(available, False, both, offered and not failed, failed, self._taken)

    def limits(self) -> ControllerLimits:
        """Return the lights of the scenario; there are no other limits."""
        return ControllerLimits(lights=tuple(self._twin.scenario.lights))

    def health(self) -> str:
        """Return a sentence with the state and the number of boards so far."""
        contacts = self.contacts()
        closed = f", contacts closed: {contacts.closed}" if contacts is not None else ""
        return f"simulated: {'armed' if self._rule else 'idle'}, {self._runs} boards seen{closed}"

    def threads(self) -> tuple[SupervisedThread, ...]:
        """Return the threads of controller and line."""
        return self._threads

    def close(self) -> None:
        """End both threads, and wait for their ends."""
        for thread in self._threads:
            thread.expect_end()
        with self._change:
            self._closing, self._rule = True, None
            self._change.notify_all()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join()

    def counts_at(self, time_s: float) -> int:
        """Return the counts of the belt's encoder up to a time of the controller's clock; it rests between boards."""
        track = self._board.passage.encoder if self._board is not None else None
        return 0 if track is None else track.counts_at(time_s - self._start_s)

    def time_of(self, counts: int) -> float:
        """Return the controller's time at which the encoder reaches a count; infinite if the belt stops before."""
        track = self._board.passage.encoder if self._board is not None else None
        return math.inf if track is None else track.time_of(counts) + self._start_s

    # --- the thread that follows the rule

    def _follow_rule(self) -> None:
        with self._change:
            while not self._closing:
                # The lock is held during the whole step, so that `disarm` never interrupts the report of a run.
                self._step(self._clock.now_s())
                with self._threads[0].waiting():
                    self._change.wait(self._wait_s())

    def _step(self, now_s: float) -> None:
        if self._rule is None:
            return
        while self._edges and self._edges[0][0] <= now_s:
            time_s, blocked = self._edges.popleft()
            # Pulses due before the edge come first, even if this thread wakes up late.
            self._report(self._rule.advance(time_s))
            self._rule.add_edge(time_s, blocked)
        self._report(self._rule.advance(now_s))

    def _report(self, events: Sequence[ControllerEvent]) -> None:
        for event in events:
            if isinstance(event, PulseFired):
                # Cameras are triggered before the pulse is reported to the host, as with the real controller.
                self._fire(event)
            self._runs += isinstance(event, BarrierBlocked)
            if isinstance(event, RunEnded):
                self._passing = False
                self._change.notify_all()
            self._events.put(event)
        if any(isinstance(event, RunEnded) for event in events):
            self._report_contacts()

    def _wait_s(self) -> float | None:
        if self._rule is None:
            return None
        times = [t for t in (self._rule.due_s(), self._edges[0][0] if self._edges else None) if t is not None]
        return max(self._clock.host_s(min(times)) - time.monotonic(), 0.0) if times else None

    def _fire(self, event: PulseFired) -> None:
        board, row = self._board, event.index
        if board is None or not self._agrees(board, event):
            error = InternalError(f"pulse {row} was fired at {event.time_s} s, when the twin did not expect one.")
            self._events.put(DeviceFault("simulated line", error))
            return
        for n in range(len(self._cameras)):
            self._expose(board, n, row, self._clock.host_s(event.time_s))

    def _agrees(self, board: SimulatedBoard, event: PulseFired) -> bool:
        if event.index >= len(board.pulses):
            return board.passage.faults.stuck is not None
        return abs(board.pulses[event.index].time_s + self._start_s - event.time_s) < SAME_TIME_S

    def _exposed(self, pixels: NDArray[np.uint8], brightness: float) -> NDArray[np.uint8]:
        if brightness == 1.0:
            return pixels
        bits = self._twin.scenario.array.bits
        grey = pixels if bits == 8 else pixels.view(np.uint16)
        return to_bytes(np.clip(grey * brightness, 0, (1 << bits) - 1).astype(grey.dtype))

    def _expose(self, board: SimulatedBoard, n: int, row: int, host_s: float) -> None:
        camera, faults = self._cameras[n], board.passage.faults
        if (interval_s := faults.free_running_interval_s(n)) is not None:
            if row == 0:
                # The exposures are a third of an interval late, so that they do not coincide with pulses.
                passing_s = board.pulses[-1].time_s - board.pulses[0].time_s
                for k in range(math.ceil(passing_s / interval_s)):
                    camera.trigger(host_s + (k + 1 / 3) * interval_s, board.pixels(n, 0))
            return
        if faults.ignored(n, row):
            return
        other = faults.metadata_row(n, row)
        last = len(board.pulses) - 1
        # An exchanged frame has the time stamp and the id of the other row.
        stamp_error_s = board.pulses[min(other, last)].time_s - board.pulses[min(row, last)].time_s
        stamp_error_s += faults.stamps_late_s(n)
        camera.trigger(
            host_s,
            board.pixels(n, row),
            lost=faults.lost(n, row),
            late_s=faults.delay_s(n, row),
            share=faults.received_share(n, row),
            stamp_error_s=stamp_error_s,
            id_error=other - row,
        )
        for after_s in faults.extra_delays_s(n, row):
            camera.trigger(host_s + after_s, board.pixels(n, row), stamp_error_s=faults.stamps_late_s(n))

    # --- the thread that lets boards pass

    def _let_boards_pass(self) -> None:
        try:
            while not self._closing:
                self._threads[1].beat()
                if self._may_pass():
                    self._let_pass()
                elif not self._passing and self._to_prepare():
                    self._prepare()
                else:
                    self._wait()
        except VaoiError as error:
            self._threads[1].expect_end()  # the fault is reported; no board comes any more
            self._events.put(DeviceFault("simulated line", error))

    def _permitted(self) -> bool:
        permit = self._permit
        valid = permit is not None and permit.number != self._spent and time.monotonic() < permit.until_s
        return valid or not self._interlock

    def _may_enter(self) -> bool:
        # The list may be emptied at any time, by a new plan.
        ready = any(board.ready for board in [*self._ready][:1])
        return ready and self._rule is not None and not self._passing and self._permitted()

    def _may_pass(self) -> bool:
        return self._may_enter() and time.monotonic() >= self._next_host_s

    def _to_prepare(self) -> bool:
        if self._still and self._rule is None:
            return False  # single pulses show the calibration board: rendering would delay their frames
        if any(not board.ready for board in [*self._ready][-1:]):
            return True
        return len(self._ready) < AHEAD and (self._boards == 0 or self._prepared < self._boards)

    def _prepare(self) -> None:
        """Render one frame; if all frames of the board are rendered, begin with the next board."""
        with self._change:
            newest = self._ready[-1] if self._ready else None
            number, plan = self._prepared, self._plan
        if newest is not None and not newest.ready:
            newest.render_one()
            with self._change:
                self._report_contacts()
            return
        board = SimulatedBoard(self._twin.passage(number), plan, len(self._cameras))
        with self._change:
            if plan is self._plan:
                self._ready.append(board)
                self._prepared += 1

    def _let_pass(self) -> None:
        with self._change:
            # Disarming, or the end of the permit, may have come since the check.
            if not self._may_enter():
                return
            self._spent = self._permit.number if self._permit else None
            self._board, self._passing, now_s = self._ready.popleft(), True, time.monotonic()
            self._start_s = self._clock.device_s(now_s + LEAD_S)
            self._next_host_s = now_s + self._interval_s
            self._edges.extend((self._start_s + t, blocked) for t, blocked in self._board.edges)
            self._report_contacts()
            self._change.notify_all()

    def _report_contacts(self) -> None:
        contacts = self.contacts()
        if contacts is not None and contacts != self._reported:
            self._reported = contacts
            self._events.put(ContactsChanged(next(self._numbers), self._clock.now_s(), contacts))

    def _wait(self) -> None:
        with self._change:
            if self._closing or self._may_pass() or (not self._passing and self._to_prepare()):
                return
            with self._threads[1].waiting():
                self._change.wait(max(self._next_host_s - time.monotonic(), 0.0) if self._may_enter() else None)


def open_simulated(config: StationConfig) -> Devices:
    """Open cameras, controller and line of `config.simulation`."""
    assert config.simulation is not None
    twin = Twin(read_scenario(config.simulation.scenario), kept_or_drawn)
    _check(twin.scenario, config)
    cameras = tuple(SimulatedCamera(n, simulated_clock(n), c.exposure_us) for n, c in enumerate(config.cameras))
    simulation, interlock = config.simulation, config.controller.interlock == "on"
    line = simulation.boards, simulation.interval_s, interlock, config.smema
    return Devices(cameras, SimulatedController(twin, cameras, *line))


def scenario_plan(twin: Twin) -> TriggerPlan:
    """Return the trigger plan of a scenario."""
    return TriggerPlan.of(twin.line, twin.scenario.line.lights, twin.program)


def check_scenario(config: StationConfig) -> None:
    """Raise InputError for a scenario that is absent, invalid, or made for another station."""
    assert config.simulation is not None
    scenario = read_scenario(config.simulation.scenario)
    _check(scenario, config)
    accept_plan(filming_plan(config), scenario_plan(Twin(scenario)), scenario.lights)


def _check(scenario: Scenario, config: StationConfig) -> None:
    where = config.simulation.scenario if config.simulation else "scenario"
    array, twin = scenario.array, Twin(scenario)
    pairs: list[tuple[str, object, object]] = [("array.cameras", array.cameras, len(config.cameras))]
    for n, camera in enumerate(config.cameras):
        width_px, height_px = array.frame_px(n)
        pairs += [
            ("array.width_px", width_px, camera.width),
            ("array.height_px", height_px, camera.height),
            ("array.bits", array.bits, 8 if camera.pixel_format == "Mono8" else 16),
        ]
    pairs.append(("its conveyor_mm_s", tuple(twin.line.conveyor_mm_s), tuple(map(float, config.line.conveyor_mm_s))))
    pairs.append(("line.barrier_mm", twin.line.barrier_mm, config.line.barrier_mm))
    for key, found, ours in pairs:
        if found != ours:
            raise InputError.field(where, key, found, f"{ours}, as in station.toml")
