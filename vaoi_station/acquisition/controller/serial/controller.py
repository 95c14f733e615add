"""The controller at a serial port: one thread talks to it, everybody else asks that thread.

What breaks is mended by the same thread: a port that vanished is opened again by its name, a controller that was
reset is given its configuration anew and armed again. The controller's answers decide what has to be done, never
what the host remembers of them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from random import randrange
from typing import Any, TypeVar

from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.interface import EventQueue, TriggerPlan
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
from vaoi_station.acquisition.controller.serial.line import Line, RefusalError, ResetError, SilentError
from vaoi_station.acquisition.controller.serial.port import Port
from vaoi_station.acquisition.controller.serial.program import DARK, Program, explain, light_step, program_of
from vaoi_station.acquisition.controller.serial.telling import Teller
from vaoi_station.acquisition.controller.serial.timebase import Timebase
from vaoi_station.config import ControllerConfig, StationConfig
from vaoi_station.errors import DeviceError, StateError, VaoiError

T = TypeVar("T")

PAUSES_S = (0.1, 0.2, 0.5, 1.0)
"""Before a port is opened again; the last one over and over."""
QUIET_S = 1.0
"""After so long without a word it is asked for its state."""
READINGS = 8
"""Of the clock, at every start of the controller."""
_CAUSES = {1: "its power came on", 2: "its reset line was pulled", 4: "its supply was too low", 8: "by its watchdog"}
_NOT_NOW: dict[int, str] = {
    Reason.LED_BUDGET: "the LEDs have not cooled down.",
    Reason.STATE: "the pulse before is still under way.",
}
_WATCHING = (State.ARMED, State.RUNNING)


def open_serial_controller(config: StationConfig) -> SerialController:
    """The controller of `[controller]`; DeviceError says why it cannot be used."""
    return SerialController(config.controller)


@dataclass(frozen=True)
class _Orders:
    """What the controller should be doing."""

    program: Program
    number: int
    """By which the firmware names this arming."""


class SerialController:
    """A `Controller`; opened, identified and disarmed when it has been made."""

    def __init__(self, config: ControllerConfig) -> None:
        self._config = config
        self._link, self._teller, self._time = Link(), Teller(), Timebase(config.baud)
        self._orders: _Orders | None = None
        self._down: DeviceError | None = None
        """Why nothing can be asked of it at the moment."""
        self._broken: DeviceError | None = None
        """What a job has found broken."""
        self._boots: int | None = None
        """The start of the controller that its time is counted from."""
        self._halted = False
        """Its guard has spoken: it is not armed again before somebody has disarmed it."""
        self._looked_at: Status | None = None
        self._lock = threading.RLock()
        """Held while orders, `_down` or the teller change."""
        self._jobs: SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = SimpleQueue()
        self._closing = threading.Event()
        self._numbers = randrange(0x10000)
        self._events: EventQueue | None = None
        self._thread: threading.Thread | None = None
        self._line: Line | None = None
        try:
            self._meet()
        except VaoiError:
            self._hang_up()
            raise

    def start(self, events: EventQueue) -> None:
        """Begin to report events."""
        self._events = events
        self._teller.start(events.put)
        self._thread = threading.Thread(target=self._work, name="controller")
        self._thread.start()

    def arm(self, plan: TriggerPlan) -> None:
        """From now on every passage of the barrier is a run with this plan."""
        self._do(lambda: self._arm(plan))

    def disarm(self) -> None:
        """Ignore the barrier; without a line, the controller will be disarmed when it is there again."""
        with self._lock:
            self._halted = False
            if self._down is not None:
                self._forget_orders()
                return
        try:
            self._do(self._disarm)
        except DeviceError:  # it broke just now, and is told by the thread that mends it
            with self._lock:
                self._forget_orders()

    def fire_one(self) -> None:
        """Trigger all cameras and LEDs once."""
        self._do(self._fire_one)

    def read_clock(self) -> ClockReading:
        """Compare clocks."""
        return self._do(self._read_clock)

    def health(self) -> str:
        """What it is and does, and how well the line is."""
        link, ident = self._link, self._ident
        state = "not reachable" if self._down else "armed" if self._orders else "idle"
        firmware = f"{ident.firmware_major}.{ident.firmware_minor}.{ident.firmware_patch}"
        noise = f"{link.bad_frames} bad frames, {link.retries} repeats, {link.strays} strays"
        clock = f"clock ± {self.clock_bound_s * 1e3:.2f} ms, {self._time.drift_ppm():+.1f} ppm"
        return f"serial: {state}, firmware {firmware}, start {link.boots}, {clock}, {noise}"

    @property
    def ident(self) -> Ident:
        """Who it is: versions, limits, start number."""
        return self._ident

    @property
    def clock_bound_s(self) -> float:
        """How well its clock is known."""
        return self._time.bound_s()

    def close(self) -> None:
        """Disarm, then close the port."""
        self.disarm()
        with self._lock:
            self._closing.set()
        self._wake()
        if self._thread is not None:
            self._thread.join()
        self._hang_up()

    # --- the thread that talks

    def _work(self) -> None:
        failures = 0
        while not self._closing.is_set():
            try:
                if self._down is not None:
                    self._meet()
                failures = 0
                self._serve()
            except ResetError as error:
                self._lose(error)
            except DeviceError as error:
                self._lose(error)
                self._hang_up()
                self._closing.wait(PAUSES_S[min(failures, len(PAUSES_S) - 1)])
                failures += 1
        self._refuse_jobs(StateError("the controller is being closed."))

    def _serve(self) -> None:
        """Until something breaks: carry out what is asked, hear what comes, see that it does what it should."""
        line = self._on_line()
        while not self._closing.is_set():
            try:
                job, future = self._jobs.get_nowait()
            except Empty:
                line.turn()
                self._look()
                if line.silence_s > QUIET_S:
                    line.status()
            else:
                _carry_out(job, future)
                if self._broken is not None:
                    raise self._broken

    def _do(self, job: Callable[[], T]) -> T:
        """Let the thread do it; DeviceError at once while the line is down."""
        if self._thread is None:
            return job()
        with self._lock:
            if self._down is not None:
                raise DeviceError(self._down.message, action=self._down.action, code=self._down.code)
            if self._closing.is_set():
                raise StateError("the controller is being closed.")
            future: Future[T] = Future()
            self._jobs.put((lambda: self._try(job), future))
        self._wake()
        return future.result()

    def _try(self, job: Callable[[], T]) -> T:
        """A job that finds the line broken ends the serving as well."""
        try:
            return job()
        except RefusalError:
            raise
        except DeviceError as error:
            self._broken = error
            raise

    def _wake(self) -> None:
        line = self._line
        if line is not None:
            line.port.wake()

    def _refuse_jobs(self, error: VaoiError) -> None:
        while True:
            try:
                _, future = self._jobs.get_nowait()
            except Empty:
                return
            future.set_exception(error)

    # --- meeting and losing it

    def _meet(self) -> None:
        """Open the port if need be; who is it, what is its time, and does it do what it should?"""
        if self._line is None:
            port = Port(self._config.port, self._config.baud)
            self._line = Line(port, self._link, self._heard, self._config.port)
        self._broken = None
        self._link.beating = False
        self._ident: Ident = check_ident(self._line.identify())
        self._begin_time(self._line)
        while True:
            orders = self._orders
            self._bring_about(orders)
            with self._lock:
                if self._orders is orders:
                    self._down = None
                    return

    def _begin_time(self, line: Line) -> None:
        """Its clock, which a reset has begun anew; what another process did with it before is history."""
        if self._boots is None:
            line.ask(Request(Type.STATUS))
            self._link.skip_history()
        elif self._boots != self._link.boots:
            self._tell_of_reset()
            self._time.restart()
        self._boots = self._link.boots
        for _ in range(READINGS):
            reading = self._read_clock()
            if self._events is not None:
                self._events.put(reading)

    def _bring_about(self, orders: _Orders | None) -> None:
        """Make it do what it should, if it does not."""
        line, status = self._on_line(), self._on_line().status()
        self._link.beating = orders is not None
        if orders is None or self._halted:
            if status.state != State.IDLE:
                line.ask(Request(Type.DISARM))
        elif not (status.state in _WATCHING and (status.run, status.config_crc) == (orders.number, orders.program.crc)):
            self._put_in_force(orders, status)
        self._looked_at = line.status()

    def _put_in_force(self, orders: _Orders, status: Status) -> None:
        line, program = self._on_line(), orders.program
        if status.state != State.IDLE:
            line.ask(Request(Type.DISARM))
        if status.config_crc != program.crc:
            for request in configuration(program.timing, program.steps):
                line.ask(request)
        line.ask(arm(orders.number, program.crc))

    def _lose(self, error: DeviceError) -> None:
        """From now on nothing can be asked of it; who waits is told."""
        self._link.abandon()
        with self._lock:
            self._down = error
        if not isinstance(error, ResetError):  # that is told when it is known what it cost
            self._teller.complain(error)
        self._refuse_jobs(error)

    def _tell_of_reset(self) -> None:
        """Named with what it cost; what had been fired of a run is kept."""
        causes = [words for bit, words in _CAUSES.items() if self._ident.reset_cause & bit]
        with self._lock:
            cost = "the run under way was ended" if self._teller.end("the controller was reset") else "no run was cut"
        self._teller.complain(
            DeviceError(
                f"The controller was reset ({', '.join(causes) or 'cause unknown'}); {cost}.",
                action="Nothing, if that was meant: it is configured and armed again. Else check its supply.",
                code="controller-reset",
            )
        )

    def _hang_up(self) -> None:
        line, self._line = self._line, None
        if line is not None:
            line.port.close()

    def _on_line(self) -> Line:
        if self._line is None:
            raise SilentError(f"The controller at {self._config.port} is not connected.")
        return self._line

    # --- what is asked of it

    def _arm(self, plan: TriggerPlan) -> None:
        program = program_of(plan, self._config, self._ident)
        self._numbers = (self._numbers + 1) % 0x10000
        orders = _Orders(program, self._numbers)
        line = self._on_line()
        try:
            self._put_in_force(orders, line.status())
        except RefusalError as refusal:
            raise explain(refusal.nak, program) or refusal from refusal
        with self._lock:
            self._orders, self._halted = orders, False
            self._teller.name_lights(program.light, program.light(0))
        self._link.beating = True
        self._looked_at = line.status()

    def _disarm(self) -> None:
        line = self._on_line()
        line.ask(Request(Type.DISARM))
        self._looked_at = line.status()
        with self._lock:
            self._forget_orders()
        self._link.beating = False

    def _forget_orders(self) -> None:
        self._orders = None
        self._teller.end("disarmed")

    def _fire_one(self) -> None:
        if self._orders is not None:
            raise StateError("the controller is armed: its pulses belong to boards.", action="Disarm, then fire.")
        name = next(iter(self._config.lights_in_turn), "")
        step = light_step(name, self._config, self._ident) if name else DARK
        self._teller.name_lights(lambda _row: "", name)
        self._numbers = (self._numbers + 1) % 0x10000
        width = min(round(self._config.trigger_us * 2), 0xFFFF)
        try:
            self._on_line().ask(fire_one(self._numbers, step, width))
        except RefusalError as refusal:
            why = _NOT_NOW.get(refusal.nak.reason)
            if why is None:
                raise
            raise StateError(why, action="Fire again in a moment.") from refusal

    def _read_clock(self) -> ClockReading:
        replied = self._on_line().ask(number_request(Type.CLOCK, randrange(1 << 32)))
        return self._time.read(ClockReply.unpack(replied.payload).tick, replied.sent_s, replied.received_s)

    # --- what it tells

    def _heard(self, item: Happened | EventsLost, now_s: float) -> None:
        with self._lock:
            if isinstance(item, EventsLost):
                self._teller.complain(
                    DeviceError(
                        f"{item.count} events of the controller were overwritten before they could be read.",
                        action="The line was down or this computer stopped for long; look at the runs of that time.",
                        code="events-lost",
                    )
                )
                return
            event = item.event
            if event.kind == Kind.FAULT and event.detail == Fault.GUARD:
                self._halted = True
            self._teller.tell(event, self._time.time_s(event.tick, now_s))

    def _look(self) -> None:
        """A new status: a run whose end was overwritten has ended; what is not watching should be."""
        status = self._link.status
        if status is None or status is self._looked_at or not self._link.up_to_date:
            return
        self._looked_at = status
        with self._lock:
            if status.state != State.RUNNING:
                self._teller.end("the controller's report of its end was lost")
            amiss = self._orders is not None and not self._halted and status.state not in _WATCHING
        if amiss:
            self._bring_about(self._orders)


def _carry_out(job: Callable[[], Any], future: Future[Any]) -> None:
    try:
        future.set_result(job())
    except BaseException as error:  # noqa: BLE001  (whoever asked gets it, whatever it is)
        future.set_exception(error)
