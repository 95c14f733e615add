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
    BoardOffer,
    BoardTooSoon,
    Contacts,
    ContactsChanged,
    Controller,
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
    check_contacts,
    check_ident,
    check_interlock,
    contacts_of,
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
from vaoi_station.config import ControllerConfig
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
_END_LOST = "the controller's report of its end was lost"


class EventTranslator:
    """Translates the firmware's events, in their order, so that each run that begins also ends, whatever was lost."""

    def __init__(self) -> None:
        self.put: Callable[[ControllerEvent | DeviceFault], None] = lambda _item: None
        self.light: Callable[[int, int], str] = lambda _row, _channels: ""
        """The name of the light of a row, whose LED channels are given as bits."""
        self.single_light = ""
        self._numbers = count()
        self._rows: int | None = None
        """Rows of the run under way; None without one."""
        self._time_s = 0.0

    def translate(self, event: Event, time_s: float) -> None:
        """Translate the next event of the firmware, and pass the resulting events of the station on to `put`."""
        kind, detail, index, value = event.kind, event.detail, event.index, event.value
        if kind == Kind.BOOT:
            return
        self._time_s = time_s
        if kind == Kind.BARRIER and detail:
            # If a run is still under way here, its end event was overwritten in the firmware's ring of events.
            self.end(_END_LOST)
            self._rows = 0
            self._emit(BarrierBlocked, value)
        elif kind == Kind.BARRIER and self._rows is not None:
            self._emit(BarrierClear, value)
        elif kind == Kind.EDGE and detail:
            # If the barrier event of a run was lost, an interruption within the run begins it.
            self._rows = self._rows or 0
            self._emit(BarrierBlockedAgain, value)
        elif kind == Kind.EDGE:
            self._emit(BarrierClearAfterRun, value)
        elif kind == Kind.PULSE and index == ROW_NONE:
            # The firmware has one event for a single pulse; the interface has a run of one row.
            self._emit(PulseFired, 0, self.single_light)
            self._emit(RunEnded, 1, "single")
        elif kind == Kind.PULSE:
            # If the barrier event of a run was lost, its first pulse begins it.
            self._rows = index + 1
            on_us, trigger_us = (round(ticks * TICK_S * 1e6, 3) for ticks in (event.on_ticks, event.width_ticks))
            self._emit(PulseFired, index, self.light(index, detail), (), (), on_us, trigger_us or None)
        elif kind == Kind.SUPPRESSED:
            self._suppressed(detail, index, value)
        elif kind == Kind.RUN_END and self._rows is not None:
            self._rows = index + value
            self.end(_ENDS.get(detail, "the controller ended it"))
        elif kind == Kind.FAULT and detail in _FAULTS:
            message, action = _FAULTS[detail]
            self.report_fault(DeviceError(message, action=action, code="controller-safe"))
        elif kind == Kind.CONTACTS:
            self._emit(ContactsChanged, contacts_of(detail, index))

    def end(self, reason: str) -> bool:
        """End the run under way. Return False if no run is under way."""
        if self._rows is None:
            return False
        rows, self._rows = self._rows, None
        self._emit(RunEnded, rows, reason)
        return True

    def report_fault(self, error: DeviceError) -> None:
        """Pass on a fault of the controller as an event."""
        self.put(DeviceFault("controller", error))

    def _suppressed(self, why: int, index: int, value: int) -> None:
        if why == Suppressed.BOUNCE:
            self._emit(BarrierBounce, value * TICK_S)
        elif why == Suppressed.GAP:
            self._emit(BoardTooSoon, value * TICK_S)
            what = f"A board came {value * TICK_S:.3f} s after the one before had left, and was not filmed."
            action = "Keep boards apart, or lower min_gap_s under [controller] in station.toml."
            self.report_fault(DeviceError(what, action=action, code="board-too-soon"))
        elif why in _SKIPPED:
            if self._rows is not None:
                self._rows = index + 1
            self._emit(PulseSkipped, index, _SKIPPED[why])

    def _emit(self, kind: Callable[..., ControllerEvent], *values: object) -> None:
        self.put(kind(next(self._numbers), self._time_s, *values))


CLOCK_READINGS = 8
STATUS_AGE_S = 1.0
PACE = BackoffPolicy(first_s=0.1, longest_s=1.0, proven_s=5.0)
"""Pauses between attempts to open the serial port again."""
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
_WHY_LOW: dict[int, str] = {
    Hold.HOST: "the station does not permit a board",
    Hold.STATE: "the controller is not armed, or a board is being filmed",
    Hold.BARRIER: "the light barrier is interrupted",
    Hold.GAP: "the last board left less than min_gap_s ago",
    Hold.SPENT: "a board has come since the station permitted one",
}
T = TypeVar("T")


@dataclass(frozen=True)
class _Arming:
    program: DeviceProgram
    number: int
    """By which the firmware identifies this arming: a status shows whether it is still in it after a reconnection."""


class SerialController(Controller):
    """A `Controller` at a serial port. The constructor opens the port, identifies the controller and disarms it.

    Once started, its thread alone uses the port. Other threads hold `_lock` when they read or change the wanted state.
    """

    def __init__(self, config: ControllerConfig, *, contacts: bool = False) -> None:
        """Open it; `contacts` is whether those of the neighbours are used."""
        self._config, self._contacts, self._waker = config, contacts, Waker()
        self._link, self._translator, self._timebase = Link(), EventTranslator(), Timebase(config.baud)
        self._publish_reading: Callable[[ClockReading], None] = lambda _reading: None
        self._lock = threading.RLock()
        self._arming: _Arming | None = None
        """The wanted state; None: disarmed."""
        self._guard_tripped = False
        """Whether the guard switched an LED off. The controller is then armed only by a caller's command."""
        self._unavailable: DeviceError | None = None
        self._ident: Ident
        self._exchange: Exchange | None = None
        self._boots: int | None = None
        """Value of the controller's boot counter for which the timebase converts ticks at present."""
        self._checked_status: Status | None = None
        self._status_s = time.monotonic()
        self._number = randrange(0x10000)
        self._encoder_watch = EncoderWatch()
        self._single_width: int | None = None
        """Width of the trigger of a single pulse, ticks, for cameras that the last plan lets expose for it."""
        self._jobs: SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = SimpleQueue()
        self._closing = threading.Event()
        self._thread = SupervisedThread(self._work, "controller", DEVICE_LIMIT_S)
        try:
            self._connect()
        except BaseException:  # also KeyboardInterrupt: free the port, then raise it again
            self._release()
            raise

    # --- called by other threads

    def start(self, events: EventQueue) -> None:
        """Begin to put events into the queue `events`."""
        self._publish_reading = self._translator.put = events.put
        self._thread.start()

    def arm(self, plan: TriggerPlan) -> None:
        """Film every board that passes the barrier from now on with this plan."""
        self._do(lambda: self._arm(plan))

    def disarm(self) -> None:
        """Ignore the barrier. A controller that cannot be reached now is disarmed as soon as it replies again."""
        with self._lock:
            self._guard_tripped = False
            if self._unavailable is not None:
                self._drop_arming()
                return
        try:
            self._do(self._disarm)
        except DeviceError:
            # The connection broke just now. The controller's thread reports that and restores it, unarmed.
            self._drop_arming()

    def fire_one(self, light: str = "", on_us: float | None = None) -> None:
        """Trigger all cameras and LEDs once, independent of the barrier."""
        self._do(lambda: self._fire_one(light, on_us))

    def read_clock(self) -> ClockReading:
        """Compare the controller's clock with the host's."""
        return self._do(self._read_clock)

    def permit_board(self, permit: Permit | None) -> None:
        """Permit the next board, or hold boards back."""
        self._link.permit = permit
        self._waker.wake()

    def offer_board(self, offer: BoardOffer | None) -> None:
        """Offer a board to the next machine by contacts, or open them."""
        self._link.offer = offer
        self._waker.wake()

    def contacts(self) -> Contacts | None:
        """Return the contacts of the newest status; None if they are not used or the controller cannot be reached."""
        status = self._link.status
        return None if not self._contacts or status is None or self._unavailable is not None else status.closed

    def line_output(self) -> LineOutput | None:
        """Return the output "line ready" of the newest status; low while the controller cannot be reached."""
        if not self._link.ready_longest_ms:
            return None
        if self._unavailable is not None:
            return LineOutput(False, "the controller cannot be reached")
        status = self._link.status
        if status is not None and status.ready:
            return LineOutput(True)
        hold = Hold.HOST if status is None else status.hold
        return LineOutput(False, _WHY_LOW.get(hold, "the controller holds boards back"))

    def barrier_blocked(self) -> bool | None:
        """Return the level of the barrier in the newest status; None while the controller cannot be reached."""
        status = self._link.status
        return None if status is None or self._unavailable is not None else bool(status.blocked)

    def is_watching(self) -> bool:
        """Return whether the controller replies, and its guard has not switched it off."""
        return self._unavailable is None and not self._guard_tripped

    def limits(self) -> ControllerLimits:
        """Return the limits of the firmware, as the controller stated them when it was opened last."""
        return ControllerLimits(firmware=firmware_limits(self._ident))

    def health(self) -> str:
        """Return state, firmware, clock and quality of the connection in one sentence."""
        link, ident, clock = self._link, self._ident, self._timebase.model
        state = "not reachable" if self._unavailable else "armed" if self._arming else "idle"
        output = self.line_output()
        ready = ""
        if output is not None:
            ready = ", line ready" if output.high else f", line not ready: {output.why}"
        elif not ident.ready_longest_ms:
            ready = ", no output 'line ready'"
        contacts = self.contacts()
        ready += f", contacts closed: {contacts.closed}" if contacts is not None else ""
        barrier = ", barrier interrupted" if link.status is not None and link.status.blocked else ""
        fit = f"clock ± {clock.bound_s() * 1e3:.2f} ms, {clock.drift_ppm:+.1f} ppm"
        noise = f"{link.bad_frames} bad frames, {link.retries} repeats, {link.unmatched} unmatched"
        return f"serial: {state}{barrier}{ready}, firmware {ident.firmware}, start {link.boots}, {fit}, {noise}"

    def threads(self) -> tuple[SupervisedThread, ...]:
        """Return the thread that uses the port."""
        return (self._thread,)

    def close(self) -> None:
        """Disarm, then close the port."""
        self.disarm()
        self._thread.expect_end()
        with self._lock:
            self._closing.set()
            self._waker.wake()
        if self._thread.ident is not None:
            self._thread.join()
        self._release()

    def _do(self, job: Callable[[], T]) -> T:
        if self._thread.ident is None:
            return job()
        with self._lock:
            if (down := self._unavailable) is not None:
                raise DeviceError(down.message, action=down.action, code=down.code)
            # Queued under the lock that `_fail_jobs` takes: the job is either refused above or failed there.
            future: Future[T] = Future()
            self._jobs.put((job, future))
            self._waker.wake()
        return future.result()

    def _drop_arming(self) -> None:
        with self._lock:
            self._arming = None
            self._translator.end("disarmed")

    # --- the controller's thread

    def _work(self) -> None:
        backoff = Backoff(PACE)
        try:
            while not self._closing.is_set():
                self._thread.beat()
                try:
                    if self._unavailable is not None:
                        backoff.start_attempt()
                        self._connect()
                    backoff.record_success()
                    self._serve()
                # `_connect` reports a reset, because it knows whether the reset cut a run short. The port stays open.
                except ResetError as error:
                    self._fail_jobs(error)
                except DeviceError as error:
                    self._translator.report_fault(error)
                    self._fail_jobs(error)
                    self._disconnect()
                    self._closing.wait(backoff.record_failure())
        finally:
            self._fail_jobs(DeviceError("The controller is no longer supervised.", action="Restart the station."))

    def _serve(self) -> None:
        self._link.contacts = self._contacts  # not before: their first report is for those who take events
        while not self._closing.is_set():
            self._thread.beat()
            try:
                job, future = self._jobs.get_nowait()
            except Empty:
                self._poll()
                continue
            try:
                future.set_result(job())
            except BaseException as error:  # any failure of the job belongs to its caller
                future.set_exception(error)
                # A refusal is a valid reply, so the connection works.
                if isinstance(error, DeviceError) and not isinstance(error, RefusalError):
                    raise

    def _fail_jobs(self, error: DeviceError) -> None:
        """Refuse all jobs from now on with this error, and end the waiting jobs with it."""
        self._link.drop_requests()
        with self._lock:
            self._unavailable = error
        while True:
            try:
                _, future = self._jobs.get_nowait()
            except Empty:
                return
            future.set_exception(error)

    def _connect(self) -> None:
        if self._exchange is None:
            port = Port(self._config.port, self._config.baud, self._waker)
            self._exchange = Exchange(port, self._link, self._on_notification, self._config.port)
        # Nothing but IDENT is sent until the identity is known.
        self._link.heartbeat, self._link.ready_longest_ms, self._link.contacts = False, 0, False
        self._ident = check_ident(self._exchange.identify())
        if self._config.interlock == "on":
            check_interlock(self._ident)
            self._link.ready_longest_ms = self._ident.ready_longest_ms
        if self._contacts:
            check_contacts(self._ident)
        if self._boots is None:
            # Events of a process that used the controller earlier are skipped.
            self._request(Request(Type.STATUS))
            self._link.skip_history()
        elif self._boots != self._link.boots:
            self._report_reset()
            self._timebase.restart()
        self._boots = self._link.boots
        for _ in range(CLOCK_READINGS):
            self._publish_reading(self._read_clock())
        while True:
            arming = self._arming
            self._apply(arming)
            with self._lock:
                # `disarm` may have dropped the arming meanwhile: then the new wanted state is applied too.
                if self._arming is arming:
                    self._unavailable = None
                    return

    def _disconnect(self) -> None:
        exchange, self._exchange = self._exchange, None
        if exchange is not None:
            exchange.port.close()

    def _release(self) -> None:
        self._disconnect()
        self._waker.close()

    def _report_reset(self) -> None:
        causes = [words for bit, words in _RESET_CAUSES.items() if self._ident.reset_cause & bit]
        with self._lock:
            ended = self._translator.end("the controller was reset")
        cost = "the run under way was ended" if ended else "no run was cut"
        what = f"The controller was reset ({', '.join(causes) or 'cause unknown'}); {cost}."
        action = "Nothing, if that was meant: it is configured and armed again. Else check its supply."
        self._translator.report_fault(DeviceError(what, action=action, code="controller-reset"))

    def _apply(self, arming: _Arming | None) -> None:
        """Bring the controller into the wanted state, unless it is in this state already."""
        status = self._connected().read_status()
        self._link.heartbeat = arming is not None
        if arming is None or self._guard_tripped:
            if status.state != State.IDLE:
                self._request(Request(Type.DISARM))
        elif not (status.state in _WATCHING and (status.run, status.config_crc) == (arming.number, arming.program.crc)):
            self._configure_and_arm(arming)
        self._checked_status = self._connected().read_status()

    def _configure_and_arm(self, arming: _Arming) -> None:
        status, program = self._connected().read_status(), arming.program
        # The firmware takes a configuration only when it is idle.
        if status.state != State.IDLE:
            self._request(Request(Type.DISARM))
        if status.config_crc != program.crc:
            for request in program.requests():
                self._request(request)
        self._request(arm(arming.number, program.crc))

    def _connected(self) -> Exchange:
        if self._exchange is None:
            raise SilentError(f"The controller at {self._config.port} is not connected.")
        return self._exchange

    def _request(self, request: Request) -> bytes:
        return self._connected().request(request).payload

    def _arm(self, plan: TriggerPlan) -> None:
        program = make_program(plan, self._config, self._ident)
        arming = _Arming(program, self._next_number())
        try:
            self._configure_and_arm(arming)
        except RefusalError as refusal:
            raise explain_refusal(refusal.nak, program) or refusal from refusal
        with self._lock:
            self._arming, self._guard_tripped = arming, False
            self._translator.light, self._translator.single_light = program.lit, program.light(0)
            self._single_width = program.widths[0] if program.widths else None
        self._link.heartbeat = True
        self._checked_status = self._connected().read_status()

    def _disarm(self) -> None:
        self._request(Request(Type.DISARM))
        self._checked_status = self._connected().read_status()
        self._drop_arming()
        self._link.heartbeat = False

    def _fire_one(self, light: str, on_us: float | None) -> None:
        if self._arming is not None:
            raise StateError("the controller is armed: its pulses belong to boards.", action="Disarm, then fire.")
        name = light or next(iter(self._config.light_sequence), "")
        step = light_step(name, self._config, firmware_limits(self._ident), on_us=on_us) if name else DARK
        self._translator.single_light = name
        width = self._single_width or min(round(self._config.trigger_us * 2), 0xFFFF)
        try:
            self._request(fire_one(self._next_number(), step, width))
        except RefusalError as refusal:
            why = _NOT_NOW.get(refusal.nak.reason)
            if why is None:
                raise
            raise StateError(why, action="Fire again in a moment.") from refusal

    def _next_number(self) -> int:
        self._number = (self._number + 1) % 0x10000
        return self._number

    def _read_clock(self) -> ClockReading:
        replied = self._connected().request(number_request(Type.CLOCK, randrange(1 << 32)))
        return self._timebase.add_reply(ClockReply.unpack(replied.payload).tick, replied.sent_s, replied.received_s)

    def _poll(self) -> None:
        exchange, before = self._connected(), self._link.status
        exchange.poll()
        self._check_status()
        if self._link.status is not before:
            self._status_s = time.monotonic()
        elif time.monotonic() - self._status_s > STATUS_AGE_S:
            exchange.read_status()

    def _on_notification(self, item: EventReceived | EventsLost, now_s: float) -> None:
        with self._lock:
            if isinstance(item, EventReceived):
                event = item.event
                self._guard_tripped |= event.kind == Kind.FAULT and event.detail == Fault.GUARD
                self._translator.translate(event, self._timebase.time_s(event.tick, now_s))
                return
            what = f"{item.count} events of the controller were overwritten before they could be read."
            action = "The link was down or this computer stopped for long; check the runs of that time."
            self._translator.report_fault(DeviceError(what, action=action, code="events-lost"))

    def _check_status(self) -> None:
        status = self._link.status
        # A status can be compared with the run only when all events before it, and none after it, were passed on.
        if (
            status is None
            or status is self._checked_status
            or self._link.status_is_outdated
            or not self._link.up_to_date
        ):
            return
        self._checked_status = status
        if self._arming is not None and (error := self._encoder_watch.check(self._arming.program.timing, status)):
            self._translator.report_fault(error)
        with self._lock:
            if status.state != State.RUNNING:
                self._translator.end(_END_LOST)
            must_arm = self._arming is not None and not self._guard_tripped and status.state not in _WATCHING
        if must_arm:
            self._apply(self._arming)
