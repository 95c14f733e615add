"""Brings the controller to do what it should, and mends what broke; everything here happens in one thread.

The controller's answers decide what has to be done, never what the host remembers of them.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from random import randrange

from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.controller.protocol.link import EventsLost, Happened, Link
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
    configuration,
    fire_one,
    number_request,
)
from vaoi_station.acquisition.controller.protocol.refusals import check_ident
from vaoi_station.acquisition.controller.serial.device_program import DARK, Program, explain, light_step, program_of
from vaoi_station.acquisition.controller.serial.event_translator import Teller
from vaoi_station.acquisition.controller.serial.exchange import Line, RefusalError, SilentError
from vaoi_station.acquisition.controller.serial.port import Alarm, Port
from vaoi_station.acquisition.controller.serial.timebase import Timebase
from vaoi_station.config import ControllerConfig
from vaoi_station.errors import DeviceError, StateError

READINGS = 8
"""Of the clock, at every meeting."""
QUIET_S = 1.0
"""After so long without a word on its state it is asked."""
_CAUSES = {1: "its power came on", 2: "its reset line was pulled", 4: "its supply was too low", 8: "by its watchdog"}
_NOT_NOW: dict[int, str] = {
    Reason.LED_BUDGET: "the LEDs have not cooled down.",
    Reason.STATE: "the pulse before is still under way.",
}
_WATCHING = (State.ARMED, State.RUNNING)


@dataclass(frozen=True)
class Orders:
    """What the controller should be doing."""

    program: Program
    number: int
    """By which the firmware names this arming."""


class Attendant:
    """Whoever uses it from another thread holds `lock`, and touches `orders`, `down`, `halted` and `teller` alone."""

    def __init__(self, config: ControllerConfig, alarm: Alarm) -> None:
        self._config, self._alarm = config, alarm
        self.link, self.teller, self.time = Link(), Teller(), Timebase(config.baud)
        self.lock = threading.RLock()
        self.orders: Orders | None = None
        self.down: DeviceError | None = None
        """Why nothing can be asked of it at the moment."""
        self.halted = False
        """Its guard has spoken: it is not armed again before somebody has disarmed it."""
        self.publish: Callable[[ClockReading], None] = lambda _reading: None
        """Told of readings of the clock after it may have jumped."""
        self.ident: Ident
        self._line: Line | None = None
        self._boots: int | None = None
        """The start of the controller that its time is counted from."""
        self._looked_at: Status | None = None
        self._told_s = time.monotonic()
        """When it last said how it is."""
        self._number = randrange(0x10000)

    # --- meeting and losing it

    def meet(self) -> None:
        """Open the port if need be; who is it, what is its time, and does it do what it should?"""
        if self._line is None:
            port = Port(self._config.port, self._config.baud, self._alarm)
            self._line = Line(port, self.link, self._heard, self._config.port)
        self.link.beating = False
        self.ident = check_ident(self._line.identify())
        self._begin_time(self._line)
        while True:
            orders = self.orders
            self._bring_about(orders)
            with self.lock:
                if self.orders is orders:
                    self.down = None
                    return

    def lose(self, error: DeviceError) -> None:
        """From now on nothing can be asked of it."""
        self.link.abandon()
        with self.lock:
            self.down = error

    def hang_up(self) -> None:
        """Close the port, if it is open."""
        line, self._line = self._line, None
        if line is not None:
            line.port.close()

    def forget_orders(self) -> None:
        """It shall do nothing, whether or not it can be told so now."""
        self.orders = None
        self.teller.end("disarmed")

    def _begin_time(self, line: Line) -> None:
        """Its clock, which a reset has begun anew; what another process did with it before is history."""
        if self._boots is None:
            line.ask(Request(Type.STATUS))
            self.link.skip_history()
        elif self._boots != self.link.boots:
            self._tell_of_reset()
            self.time.restart()
        self._boots = self.link.boots
        for _ in range(READINGS):
            self.publish(self.read_clock())

    def _bring_about(self, orders: Orders | None) -> None:
        """Make it do what it should, if it does not."""
        line, status = self._on_line(), self._on_line().status()
        self.link.beating = orders is not None
        if orders is None or self.halted:
            if status.state != State.IDLE:
                line.ask(Request(Type.DISARM))
        elif not (status.state in _WATCHING and (status.run, status.config_crc) == (orders.number, orders.program.crc)):
            self._put_in_force(orders, status)
        self._looked_at = line.status()

    def _put_in_force(self, orders: Orders, status: Status) -> None:
        line, program = self._on_line(), orders.program
        if status.state != State.IDLE:
            line.ask(Request(Type.DISARM))
        if status.config_crc != program.crc:
            for request in configuration(program.timing, program.steps):
                line.ask(request)
        line.ask(arm(orders.number, program.crc))

    def _tell_of_reset(self) -> None:
        """Named with what it cost; what had been fired of a run is kept."""
        causes = [words for bit, words in _CAUSES.items() if self.ident.reset_cause & bit]
        with self.lock:
            cost = "the run under way was ended" if self.teller.end("the controller was reset") else "no run was cut"
        self.teller.complain(
            DeviceError(
                f"The controller was reset ({', '.join(causes) or 'cause unknown'}); {cost}.",
                action="Nothing, if that was meant: it is configured and armed again. Else check its supply.",
                code="controller-reset",
            )
        )

    def _on_line(self) -> Line:
        if self._line is None:
            raise SilentError(f"The controller at {self._config.port} is not connected.")
        return self._line

    # --- what is asked of it

    def arm(self, plan: TriggerPlan) -> None:
        """See `Controller.arm`."""
        program = program_of(plan, self._config, self.ident)
        self._number = (self._number + 1) % 0x10000
        orders = Orders(program, self._number)
        line = self._on_line()
        try:
            self._put_in_force(orders, line.status())
        except RefusalError as refusal:
            raise explain(refusal.nak, program) or refusal from refusal
        with self.lock:
            self.orders, self.halted = orders, False
            self.teller.name_lights(program.light, program.light(0))
        self.link.beating = True
        self._looked_at = line.status()

    def disarm(self) -> None:
        """See `Controller.disarm`."""
        line = self._on_line()
        line.ask(Request(Type.DISARM))
        self._looked_at = line.status()
        with self.lock:
            self.forget_orders()
        self.link.beating = False

    def fire_one(self) -> None:
        """See `Controller.fire_one`."""
        if self.orders is not None:
            raise StateError("the controller is armed: its pulses belong to boards.", action="Disarm, then fire.")
        name = next(iter(self._config.lights_in_turn), "")
        step = light_step(name, self._config, self.ident) if name else DARK
        self.teller.name_lights(lambda _row: "", name)
        self._number = (self._number + 1) % 0x10000
        width = min(round(self._config.trigger_us * 2), 0xFFFF)
        try:
            self._on_line().ask(fire_one(self._number, step, width))
        except RefusalError as refusal:
            why = _NOT_NOW.get(refusal.nak.reason)
            if why is None:
                raise
            raise StateError(why, action="Fire again in a moment.") from refusal

    def read_clock(self) -> ClockReading:
        """See `Controller.read_clock`."""
        replied = self._on_line().ask(number_request(Type.CLOCK, randrange(1 << 32)))
        return self.time.read(ClockReply.unpack(replied.payload).tick, replied.sent_s, replied.received_s)

    # --- what it tells

    def listen(self) -> None:
        """Hear what comes within a moment, and see that it does what it should."""
        line, before = self._on_line(), self.link.status
        line.turn()
        self._look()
        if self.link.status is not before:
            self._told_s = time.monotonic()
        elif time.monotonic() - self._told_s > QUIET_S:
            line.status()

    def _heard(self, item: Happened | EventsLost, now_s: float) -> None:
        with self.lock:
            if isinstance(item, EventsLost):
                self.teller.complain(
                    DeviceError(
                        f"{item.count} events of the controller were overwritten before they could be read.",
                        action="The line was down or this computer stopped for long; look at the runs of that time.",
                        code="events-lost",
                    )
                )
                return
            event = item.event
            if event.kind == Kind.FAULT and event.detail == Fault.GUARD:
                self.halted = True
            self.teller.tell(event, self.time.time_s(event.tick, now_s))

    def _look(self) -> None:
        """A new status: a run whose end was overwritten has ended; what is not watching should be."""
        status = self.link.status
        if status is None or status is self._looked_at or self.link.status_is_old or not self.link.up_to_date:
            return
        self._looked_at = status
        with self.lock:
            if status.state != State.RUNNING:
                self.teller.end("the controller's report of its end was lost")
            amiss = self.orders is not None and not self.halted and status.state not in _WATCHING
        if amiss:
            self._bring_about(self.orders)
