"""The controller at a serial port: one thread keeps it in the wanted state; others give it jobs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import count
from queue import Empty, SimpleQueue
from random import randrange
from typing import Any, TypeVar

from vaoi_station.acquisition.cameras.interface import DeviceFault
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierBlockedAgain,
    BarrierBounce,
    BarrierClear,
    BarrierClearAfterRun,
    BoardTooSoon,
    ControllerEvent,
    ControllerLimits,
    EventQueue,
    LineOutput,
    Permit,
    PulseFired,
    PulseSkipped,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.controller.protocol import (
    ROW_NONE,
    TICK_S,
    ClockReply,
    Event,
    EventReceived,
    EventsLost,
    Fault,
    Hold,
    Ident,
    Kind,
    Link,
    Pacing,
    Reason,
    Request,
    RunEnd,
    State,
    Status,
    Suppressed,
    Timing,
    Type,
    arm,
    check_ident,
    check_interlock,
    fire_one,
    number_request,
)
from vaoi_station.acquisition.controller.serial.device_program import (
    DARK,
    DeviceProgram,
    explain_refusal,
    firmware_limits,
    light_step,
    make_program,
)
from vaoi_station.acquisition.controller.serial.exchange import (
    Exchange,
    Port,
    RefusalError,
    ResetError,
    SilentError,
    Timebase,
    Waker,
)
from vaoi_station.acquisition.controller.trigger_rule import TOO_FAST
from vaoi_station.backoff import Backoff, BackoffPolicy
from vaoi_station.config import ControllerConfig, StationConfig
from vaoi_station.errors import DeviceError, StateError
from vaoi_station.supervised_thread import DEVICE_LIMIT_S, SupervisedThread

STILL_S = 5.0
"""Time without a count, while a board is in the barrier or its tail, after which this is reported."""
BACKWARDS_COUNTS = 20
"""Counts backwards that are reported: a belt at rest may shake by a few."""
_WRAP = 1 << 32


class EncoderWatch:
    """Evaluates the positions of successive status messages of one run."""

    def __init__(self) -> None:
        self._run: tuple[int, int] | None = None
        """Boot counter of the controller, and the number of its arming; None while no run is under way."""
        self._position = self._tick = 0
        self._reported = False

    def check(self, timing: Timing, status: Status) -> DeviceError | None:
        """Return an error, once per run, if the encoder stands still or counts backwards; otherwise None."""
        if timing.pacing != Pacing.DISTANCE or status.state != State.RUNNING:
            self._run = None
            return None
        if self._run != (status.boots, status.run):
            self._run, self._reported = (status.boots, status.run), False
            self._position, self._tick = status.position, status.tick
            return None
        moved = (status.position - self._position + _WRAP // 2) % _WRAP - _WRAP // 2
        if moved > 0:
            self._position, self._tick = status.position, status.tick
        still_s = (status.tick - self._tick) % _WRAP * TICK_S
        if self._reported or (moved > -BACKWARDS_COUNTS and still_s < STILL_S):
            return None
        self._reported = True
        if moved <= -BACKWARDS_COUNTS:
            return DeviceError(
                f"The encoder has counted {-moved} backwards while a board passes: no row is fired.",
                action="Exchange its channels A and B (hw/wiring.md), or check the direction of the belt.",
                code="encoder-backwards",
            )
        return DeviceError(
            f"The encoder has not counted for {still_s:.1f} s while a board is in the barrier: no row is fired.",
            action="Check that the belt runs, then the encoder and its cable (vaoi doctor); disarm to end the run.",
            code="encoder-silent",
        )


_ENDS: dict[int, str] = {
    RunEnd.CLEAR: "clear",
    RunEnd.MAX_ROWS: "max-rows",
    RunEnd.DISARMED: "disarmed",
    RunEnd.SAFE: "the controller went into its safe state",
}
_SKIPPED: dict[int, str] = {
    Suppressed.LATE: "the controller did not fire it: it could not be prepared in time",
    Suppressed.LED_BUDGET: "the controller did not fire it: the LEDs had not cooled down",
    Suppressed.TOO_FAST: TOO_FAST,
}
_FAULTS: dict[int, tuple[str, str]] = {
    Fault.HEARTBEAT: (
        "The controller received no heartbeat from this computer for too long and switched all outputs off; "
        "boards that passed meanwhile were not filmed.",
        "Nothing, if this computer was stopped or the cable unplugged; the controller is armed again automatically.",
    ),
    Fault.COMMANDED: ("The controller received the command to switch all outputs off.", "Arm again."),
    Fault.GUARD: (
        "The controller's guard switched off an LED that was on for too long.",
        "Check the LED drivers and their wiring, then arm again.",
    ),
}


class EventTranslator:
    """Translator of events, in their order. It follows the run under way, so that each run that begins also ends."""

    def __init__(self) -> None:
        self._put: Callable[[ControllerEvent | DeviceFault], None] | None = None
        self._numbers = count()
        self._light: Callable[[int, int], str] = lambda _row, _channels: ""
        self._single_light = ""
        self._running = False
        self._rows = 0
        self._time_s = 0.0

    @property
    def running(self) -> bool:
        """Whether a run is under way."""
        return self._running

    def start(self, put: Callable[[ControllerEvent | DeviceFault], None]) -> None:
        """Pass events to `put` from now on. Events before this call are dropped."""
        self._put = put

    def set_lights(self, light: Callable[[int, int], str], single: str) -> None:
        """Set the names of the lights."""
        self._light, self._single_light = light, single

    def translate(self, event: Event, time_s: float) -> None:
        """Translate the next event of the firmware, and pass the resulting events of the station on to `put`."""
        if event.kind == Kind.BOOT:
            return
        self._time_s = time_s
        if event.kind == Kind.BARRIER:
            self._barrier(event, time_s)
        elif event.kind == Kind.EDGE:
            self._edge(event, time_s)
        elif event.kind == Kind.PULSE:
            self._pulse(event, time_s)
        elif event.kind == Kind.SUPPRESSED:
            self._suppressed(event, time_s)
        elif event.kind == Kind.RUN_END and self._running:
            self._end(time_s, event.index + event.value, _ENDS.get(event.detail, "the controller ended it"))
        elif event.kind == Kind.FAULT and event.detail in _FAULTS:
            message, action = _FAULTS[event.detail]
            self.report_fault(DeviceError(message, action=action, code="controller-safe"))

    def end(self, reason: str) -> bool:
        """End the run under way, whose end the controller will not report. Return False if no run is under way."""
        if not self._running:
            return False
        self._end(self._time_s, self._rows, reason)
        return True

    def report_fault(self, error: DeviceError) -> None:
        """Pass on a fault of the controller as an event."""
        if self._put is not None:
            self._put(DeviceFault("controller", error))

    def _barrier(self, event: Event, time_s: float) -> None:
        if event.detail:
            # If a run is still under way here, its end event was overwritten in the firmware's ring of events.
            self.end("the controller's report of its end was lost")
            self._running, self._rows = True, 0
            self._emit(BarrierBlocked(next(self._numbers), time_s, event.value))
        elif self._running:
            self._emit(BarrierClear(next(self._numbers), time_s, event.value))

    def _edge(self, event: Event, time_s: float) -> None:
        if event.detail:
            # If the barrier event of a run was lost, an interruption within the run begins it.
            if not self._running:
                self._running, self._rows = True, 0
            self._emit(BarrierBlockedAgain(next(self._numbers), time_s, event.value))
        else:
            self._emit(BarrierClearAfterRun(next(self._numbers), time_s, event.value))

    def _pulse(self, event: Event, time_s: float) -> None:
        if event.index == ROW_NONE:
            # The firmware has one event for a single pulse; the interface has a run of one row.
            self._emit(PulseFired(next(self._numbers), time_s, 0, self._single_light))
            self._emit(RunEnded(next(self._numbers), time_s, 1, "single"))
            return
        # If the barrier event of a run was lost, its first pulse begins it.
        self._running, self._rows = True, event.index + 1
        light = self._light(event.index, event.detail)
        on_us = round(event.on_ticks * TICK_S * 1e6, 3)
        trigger_us = round(event.width_ticks * TICK_S * 1e6, 3) or None
        self._emit(PulseFired(next(self._numbers), time_s, event.index, light, on_us=on_us, trigger_us=trigger_us))

    def _suppressed(self, event: Event, time_s: float) -> None:
        if event.detail == Suppressed.BOUNCE:
            self._emit(BarrierBounce(next(self._numbers), time_s, event.value * TICK_S))
        elif event.detail == Suppressed.GAP:
            self._emit(BoardTooSoon(next(self._numbers), time_s, event.value * TICK_S))
            self.report_fault(
                DeviceError(
                    f"A board came {event.value * TICK_S:.3f} s after the one before had left, and was not filmed.",
                    action="Keep boards apart, or lower min_gap_s under [controller] in station.toml.",
                    code="board-too-soon",
                )
            )
        elif event.detail in _SKIPPED:
            self._rows = event.index + 1
            self._emit(PulseSkipped(next(self._numbers), time_s, event.index, _SKIPPED[event.detail]))

    def _end(self, time_s: float, rows: int, reason: str) -> None:
        self._running = False
        self._emit(RunEnded(next(self._numbers), time_s, rows, reason))

    def _emit(self, event: ControllerEvent) -> None:
        if self._put is not None:
            self._put(event)


CLOCK_READINGS = 8
"""Count of clock readings taken at every connection."""
STATUS_AGE_S = 1.0
"""Age of the newest status after which it is read again."""
_RESET_CAUSES = {
    1: "its power came on",
    2: "its reset line was pulled",
    4: "its supply was too low",
    8: "by its watchdog",
}
_NOT_NOW: dict[int, str] = {
    Reason.LED_BUDGET: "the LEDs have not cooled down.",
    Reason.STATE: "the pulse before is still under way.",
}
_WATCHING = (State.ARMED, State.RUNNING)


@dataclass(frozen=True)
class Arming:
    """The wanted state of the controller while it is armed: the plan, translated for the firmware."""

    program: DeviceProgram
    number: int
    """Number by which the firmware identifies this arming."""


class Supervisor:
    """Connects, arms, polls and restores the controller.

    One thread calls the methods. Other threads hold `lock` and use only `arming`, `unavailable`, `guard_tripped`,
    `translator` and `drop_arming`.
    """

    def __init__(self, config: ControllerConfig, waker: Waker) -> None:
        self._config, self._waker = config, waker
        self.link, self.translator, self.timebase = Link(), EventTranslator(), Timebase(config.baud)
        self.lock = threading.RLock()
        self.arming: Arming | None = None
        self.unavailable: DeviceError | None = None
        """The error that says why the controller cannot be reached at present; None if it can be reached."""
        self.guard_tripped = False
        """Whether the controller's guard switched an LED off. The controller is then armed only by a caller's
        command."""
        self.publish_reading: Callable[[ClockReading], None] = lambda _reading: None
        """Callback for clock readings after a possible jump of the clock."""
        self.ident: Ident
        self._exchange: Exchange | None = None
        self._boots: int | None = None
        """Value of the controller's boot counter for which `timebase` converts ticks at present."""
        self._checked_status: Status | None = None
        self._status_s = time.monotonic()
        """Monotonic time, s, at which the newest status arrived."""
        self._number = randrange(0x10000)
        self._encoder_watch = EncoderWatch()
        self._single_width: int | None = None
        """Width of the trigger of a single pulse, ticks, for cameras that the last plan lets expose for it."""

    # --- connecting and disconnecting

    def connect(self) -> None:
        """Open the port if it is closed, identify the controller, fit its clock, and set the wanted state."""
        if self._exchange is None:
            port = Port(self._config.port, self._config.baud, self._waker)
            self._exchange = Exchange(port, self.link, self._on_notification, self._config.port)
        # Nothing but IDENT is sent until the identity is known.
        self.link.heartbeat, self.link.ready_longest_ms = False, 0
        self.ident = check_ident(self._exchange.identify())
        if self._config.interlock == "on":
            check_interlock(self.ident)
            self.link.ready_longest_ms = self.ident.ready_longest_ms
        self._start_timebase(self._exchange)
        while True:
            arming = self.arming
            self._apply(arming)
            with self.lock:
                # `disarm` may have been called meanwhile; it only drops the arming. So the new wanted state is applied
                # too.
                if self.arming is arming:
                    self.unavailable = None
                    return

    def mark_lost(self, error: DeviceError) -> None:
        """Refuse requests from now on. `error` is the error of each refusal."""
        self.link.drop_requests()
        with self.lock:
            self.unavailable = error

    def disconnect(self) -> None:
        """Close the port if it is open."""
        exchange, self._exchange = self._exchange, None
        if exchange is not None:
            exchange.port.close()

    def drop_arming(self) -> None:
        """Set the wanted state to disarmed, and end the run."""
        self.arming = None
        self.translator.end("disarmed")

    def _start_timebase(self, exchange: Exchange) -> None:
        """Begin the clock fit after a reset of the controller. Skip the events of a process that used it earlier."""
        if self._boots is None:
            exchange.request(Request(Type.STATUS))
            self.link.skip_history()
        elif self._boots != self.link.boots:
            self._report_reset()
            self.timebase.restart()
        self._boots = self.link.boots
        for _ in range(CLOCK_READINGS):
            self.publish_reading(self.read_clock())

    def _apply(self, arming: Arming | None) -> None:
        """Bring the controller into the wanted state, unless it is in this state already."""
        exchange = self._exchange_or_error()
        status = exchange.read_status()
        self.link.heartbeat = arming is not None
        if arming is None or self.guard_tripped:
            if status.state != State.IDLE:
                exchange.request(Request(Type.DISARM))
        elif not (status.state in _WATCHING and (status.run, status.config_crc) == (arming.number, arming.program.crc)):
            self._configure_and_arm(arming, status)
        self._checked_status = exchange.read_status()

    def _configure_and_arm(self, arming: Arming, status: Status) -> None:
        exchange, program = self._exchange_or_error(), arming.program
        # The firmware takes a configuration only when it is idle.
        if status.state != State.IDLE:
            exchange.request(Request(Type.DISARM))
        if status.config_crc != program.crc:
            for request in program.requests():
                exchange.request(request)
        exchange.request(arm(arming.number, program.crc))

    def _report_reset(self) -> None:
        """Report that the controller was reset, its cause and its effects."""
        causes = [words for bit, words in _RESET_CAUSES.items() if self.ident.reset_cause & bit]
        with self.lock:
            cost = (
                "the run under way was ended" if self.translator.end("the controller was reset") else "no run was cut"
            )
        self.translator.report_fault(
            DeviceError(
                f"The controller was reset ({', '.join(causes) or 'cause unknown'}); {cost}.",
                action="Nothing, if that was meant: it is configured and armed again. Else check its supply.",
                code="controller-reset",
            )
        )

    def _exchange_or_error(self) -> Exchange:
        if self._exchange is None:
            raise SilentError(f"The controller at {self._config.port} is not connected.")
        return self._exchange

    # --- requests

    def arm(self, plan: TriggerPlan) -> None:
        """Arm the controller; see `Controller.arm`."""
        program = make_program(plan, self._config, self.ident)
        self._number = (self._number + 1) % 0x10000
        # Each arming has a new number: after a reconnection, the status shows whether the firmware is still in this
        # arming.
        arming = Arming(program, self._number)
        exchange = self._exchange_or_error()
        try:
            self._configure_and_arm(arming, exchange.read_status())
        except RefusalError as refusal:
            raise explain_refusal(refusal.nak, program) or refusal from refusal
        with self.lock:
            self.arming, self.guard_tripped = arming, False
            self.translator.set_lights(program.lit, program.light(0))
            self._single_width = program.widths[0] if program.widths else None
        self.link.heartbeat = True
        self._checked_status = exchange.read_status()

    def disarm(self) -> None:
        """Disarm the controller; see `Controller.disarm`."""
        exchange = self._exchange_or_error()
        exchange.request(Request(Type.DISARM))
        self._checked_status = exchange.read_status()
        with self.lock:
            self.drop_arming()
        self.link.heartbeat = False

    def fire_one(self, light: str = "", on_us: float | None = None) -> None:
        """Fire one pulse; see `Controller.fire_one`."""
        if self.arming is not None:
            raise StateError("the controller is armed: its pulses belong to boards.", action="Disarm, then fire.")
        name = light or next(iter(self._config.light_sequence), "")
        step = light_step(name, self._config, firmware_limits(self.ident), on_us=on_us) if name else DARK
        self.translator.set_lights(lambda _row, _channels: "", name)
        self._number = (self._number + 1) % 0x10000
        width = self._single_width or min(round(self._config.trigger_us * 2), 0xFFFF)
        try:
            self._exchange_or_error().request(fire_one(self._number, step, width))
        except RefusalError as refusal:
            why = _NOT_NOW.get(refusal.nak.reason)
            if why is None:
                raise
            raise StateError(why, action="Fire again in a moment.") from refusal

    def permit_board(self, permit: Permit | None) -> None:
        """Set what the controller shows of the next board; see `Controller.permit_board`. Any thread may call it."""
        self.link.permit = permit
        self._waker.wake()

    def read_clock(self) -> ClockReading:
        """Compare the controller's clock with the host's; see `Controller.read_clock`."""
        replied = self._exchange_or_error().request(number_request(Type.CLOCK, randrange(1 << 32)))
        return self.timebase.add_reply(ClockReply.unpack(replied.payload).tick, replied.sent_s, replied.received_s)

    # --- events

    def poll(self) -> None:
        """Receive events for a moment. If the controller is no longer in the wanted state, restore this state."""
        exchange, before = self._exchange_or_error(), self.link.status
        exchange.poll()
        self._check_status()
        if self.link.status is not before:
            self._status_s = time.monotonic()
        elif time.monotonic() - self._status_s > STATUS_AGE_S:
            exchange.read_status()

    def _on_notification(self, item: EventReceived | EventsLost, now_s: float) -> None:
        with self.lock:
            if isinstance(item, EventsLost):
                self.translator.report_fault(
                    DeviceError(
                        f"{item.count} events of the controller were overwritten before they could be read.",
                        action="The link was down or this computer stopped for long; check the runs of that time.",
                        code="events-lost",
                    )
                )
                return
            event = item.event
            if event.kind == Kind.FAULT and event.detail == Fault.GUARD:
                self.guard_tripped = True
            self.translator.translate(event, self.timebase.time_s(event.tick, now_s))

    def _check_status(self) -> None:
        """Evaluate a new status. End a run whose end was lost, and arm the controller again if it is not armed."""
        status = self.link.status
        # A status can be compared with the run only when all events before it, and none after it, were passed on.
        if status is None or status is self._checked_status or self.link.status_is_outdated or not self.link.up_to_date:
            return
        self._checked_status = status
        if self.arming is not None and (error := self._encoder_watch.check(self.arming.program.timing, status)):
            self.translator.report_fault(error)
        with self.lock:
            if status.state != State.RUNNING:
                self.translator.end("the controller's report of its end was lost")
            must_arm = self.arming is not None and not self.guard_tripped and status.state not in _WATCHING
        if must_arm:
            self._apply(self.arming)


T = TypeVar("T")

PACE = BackoffPolicy(first_s=0.1, longest_s=1.0, proven_s=5.0)
"""Pauses between attempts to open the serial port again."""
_WHY_LOW: dict[int, str] = {
    Hold.HOST: "the station does not permit a board",
    Hold.STATE: "the controller is not armed, or a board is being filmed",
    Hold.BARRIER: "the light barrier is interrupted",
    Hold.GAP: "the last board left less than min_gap_s ago",
    Hold.SPENT: "a board has come since the station permitted one",
}


def open_serial_controller(config: StationConfig) -> SerialController:
    """Open the controller of `[controller]` in station.toml."""
    return SerialController(config.controller)


class SerialController:
    """A `Controller` at a serial port. The constructor opens the port, identifies the controller and disarms it."""

    def __init__(self, config: ControllerConfig) -> None:
        self._waker = Waker()
        self._supervisor = Supervisor(config, self._waker)
        self._broken: DeviceError | None = None
        """The connection failure during the last job; None if there was none."""
        self._jobs: SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = SimpleQueue()
        self._backoff = Backoff(PACE)
        self._closing = threading.Event()
        self._thread = SupervisedThread(self._work, "controller", DEVICE_LIMIT_S)
        try:
            self._supervisor.connect()
        except BaseException:  # also KeyboardInterrupt: free the port, then raise it again
            self._release()
            raise

    def start(self, events: EventQueue) -> None:
        """Begin to put events into the queue `events`."""
        self._supervisor.publish_reading = events.put
        self._supervisor.translator.start(events.put)
        self._thread.start()

    def arm(self, plan: TriggerPlan) -> None:
        """Film every board that passes the barrier from now on with this plan."""
        self._do(lambda: self._supervisor.arm(plan))

    def disarm(self) -> None:
        """Ignore the barrier. A controller that cannot be reached now is disarmed as soon as it replies again."""
        supervisor = self._supervisor
        with supervisor.lock:
            supervisor.guard_tripped = False
            if supervisor.unavailable is not None:
                supervisor.drop_arming()
                return
        try:
            self._do(supervisor.disarm)
        except DeviceError:
            # The connection broke just now. The controller's thread reports that and restores it, unarmed.
            with supervisor.lock:
                supervisor.drop_arming()

    def fire_one(self, light: str = "", on_us: float | None = None) -> None:
        """Trigger all cameras and LEDs once, independent of the barrier."""
        self._do(lambda: self._supervisor.fire_one(light, on_us))

    def read_clock(self) -> ClockReading:
        """Compare the controller's clock with the host's."""
        return self._do(self._supervisor.read_clock)

    def permit_board(self, permit: Permit | None) -> None:
        """Permit the next board, or hold boards back."""
        self._supervisor.permit_board(permit)

    def line_output(self) -> LineOutput | None:
        """Return the output "line ready" of the newest status; low while the controller cannot be reached."""
        supervisor = self._supervisor
        if not supervisor.link.ready_longest_ms:
            return None
        if supervisor.unavailable is not None:
            return LineOutput(False, "the controller cannot be reached")
        status = supervisor.link.status
        high = status is not None and bool(status.ready)
        hold = Hold.HOST if status is None else status.hold
        return LineOutput(high, "" if high else _WHY_LOW.get(hold, "the controller holds boards back"))

    def barrier_blocked(self) -> bool | None:
        """Return the level of the barrier in the newest status; None while the controller cannot be reached."""
        status = self._supervisor.link.status
        return None if status is None or self._supervisor.unavailable is not None else bool(status.blocked)

    def is_watching(self) -> bool:
        """Return whether the controller replies, and its guard has not switched it off."""
        return self._supervisor.unavailable is None and not self._supervisor.guard_tripped

    def limits(self) -> ControllerLimits:
        """Return the limits of the firmware, as the controller stated them when it was opened last."""
        return ControllerLimits(firmware=firmware_limits(self.ident))

    def health(self) -> str:
        """Return state, firmware, clock and quality of the connection in one sentence."""
        supervisor, link, ident = self._supervisor, self._supervisor.link, self.ident
        state = "not reachable" if supervisor.unavailable else "armed" if supervisor.arming else "idle"
        output = self.line_output()
        ready = ""
        if output is not None:
            ready = ", line ready" if output.high else f", line not ready: {output.why}"
        elif not ident.ready_longest_ms:
            ready = ", no output 'line ready'"
        barrier = ", barrier interrupted" if link.status is not None and link.status.blocked else ""
        firmware = f"{ident.firmware_major}.{ident.firmware_minor}.{ident.firmware_patch}"
        noise = f"{link.bad_frames} bad frames, {link.retries} repeats, {link.unmatched} unmatched"
        clock = f"clock ± {self.clock_bound_s * 1e3:.2f} ms, {supervisor.timebase.drift_ppm():+.1f} ppm"
        return f"serial: {state}{barrier}{ready}, firmware {firmware}, start {link.boots}, {clock}, {noise}"

    @property
    def ident(self) -> Ident:
        """The controller's identity: versions, limits and boot counter."""
        return self._supervisor.ident

    @property
    def clock_bound_s(self) -> float:
        """The largest error of the clock fit at this moment, in s."""
        return self._supervisor.timebase.bound_s()

    def threads(self) -> tuple[SupervisedThread, ...]:
        """Return the thread that uses the port."""
        return (self._thread,)

    def close(self) -> None:
        """Disarm, then close the port."""
        self.disarm()
        self._thread.expect_end()
        with self._supervisor.lock:
            self._closing.set()
            self._waker.wake()
        if self._thread.ident is not None:
            self._thread.join()
        self._release()

    def _do(self, job: Callable[[], T]) -> T:
        """Let the controller's thread do a job, and wait for its outcome."""
        if self._thread.ident is None:
            return job()
        with self._supervisor.lock:
            if (down := self._supervisor.unavailable) is not None:
                raise DeviceError(down.message, action=down.action, code=down.code)
            # Queued under the lock that `mark_lost` takes: the job is either refused above or failed by `_fail_jobs`.
            future: Future[T] = Future()
            self._jobs.put((lambda: self._try(job), future))
            self._waker.wake()
        return future.result()

    # --- the controller's thread

    def _work(self) -> None:
        try:
            self._serve_and_reconnect()
        finally:
            self._fail_jobs(DeviceError("The controller is no longer supervised.", action="Restart the station."))

    def _serve_and_reconnect(self) -> None:
        while not self._closing.is_set():
            self._thread.beat()
            try:
                if self._supervisor.unavailable is not None:
                    self._backoff.start_attempt()
                    self._supervisor.connect()
                self._backoff.record_success()
                self._serve()
            # `connect` reports a reset, because it knows whether the reset cut a run short. The port is still open.
            except ResetError as error:
                self._fail_jobs(error)
            except DeviceError as error:
                self._supervisor.translator.report_fault(error)
                self._fail_jobs(error)
                self._supervisor.disconnect()
                self._closing.wait(self._backoff.record_failure())

    def _serve(self) -> None:
        """Do jobs and receive events, in the controller's thread, until the connection fails."""
        self._broken = None
        while not self._closing.is_set():
            self._thread.beat()
            try:
                job, future = self._jobs.get_nowait()
            except Empty:
                self._supervisor.poll()
            else:
                _run_job(job, future)
                if self._broken is not None:
                    raise self._broken

    def _try(self, job: Callable[[], T]) -> T:
        """Do a job, and set its outcome. If the connection fails during the job, `_serve` ends too."""
        try:
            return job()
        # A refusal is a valid reply, so the connection works.
        except RefusalError:
            raise
        except DeviceError as error:
            self._broken = error
            raise

    def _fail_jobs(self, error: DeviceError) -> None:
        """Refuse all jobs from now on with this error, and end the waiting jobs with it."""
        self._supervisor.mark_lost(error)
        while True:
            try:
                _, future = self._jobs.get_nowait()
            except Empty:
                return
            future.set_exception(error)

    def _release(self) -> None:
        self._supervisor.disconnect()
        self._waker.close()


def _run_job(job: Callable[[], Any], future: Future[Any]) -> None:
    try:
        future.set_result(job())
    except BaseException as error:  # noqa: BLE001  (any failure of the job belongs to its caller)
        future.set_exception(error)
