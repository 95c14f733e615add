"""Keep the controller in the wanted state, and restore this state after failures. All of this happens in one thread.

The supervisor decides by the controller's present status, never by what the host remembers: a reset or another process
may have changed the state.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from random import randrange

from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.interface import Permit, TriggerPlan
from vaoi_station.acquisition.controller.protocol.link import EventReceived, EventsLost, Link
from vaoi_station.acquisition.controller.protocol.messages import (
    ClockReply,
    Fault,
    Ident,
    Kind,
    Reason,
    Request,
    State,
    Status,
    Type,
    arm,
    fire_one,
    number_request,
)
from vaoi_station.acquisition.controller.protocol.refusals import check_ident, check_interlock
from vaoi_station.acquisition.controller.serial.device_program import (
    DARK,
    DeviceProgram,
    explain_refusal,
    firmware_limits,
    light_step,
    make_program,
)
from vaoi_station.acquisition.controller.serial.encoder_watch import EncoderWatch
from vaoi_station.acquisition.controller.serial.event_translator import EventTranslator
from vaoi_station.acquisition.controller.serial.exchange import Exchange, RefusalError, SilentError
from vaoi_station.acquisition.controller.serial.port import Port, Waker
from vaoi_station.acquisition.controller.serial.timebase import Timebase
from vaoi_station.config import ControllerConfig
from vaoi_station.errors import DeviceError, StateError

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
        """Set the wanted state to disarmed, and end the run.

        The controller is disarmed as soon as it can be reached.
        """
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
        """Report that the controller was reset, its cause and its effects.

        A run under way ends with the rows it has.
        """
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
