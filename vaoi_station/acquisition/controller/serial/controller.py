"""The controller at a serial port: one thread talks to it, everybody else asks that thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.interface import EventQueue, TriggerPlan
from vaoi_station.acquisition.controller.protocol.messages import Ident
from vaoi_station.acquisition.controller.serial.exchange import RefusalError, ResetError
from vaoi_station.acquisition.controller.serial.port import Waker
from vaoi_station.acquisition.controller.serial.supervisor import Supervisor
from vaoi_station.backoff import Backoff, BackoffPolicy
from vaoi_station.config import ControllerConfig, StationConfig
from vaoi_station.errors import DeviceError

T = TypeVar("T")

PACE = BackoffPolicy(first_s=0.1, longest_s=1.0, proven_s=5.0)
"""How soon a port is opened again."""


def open_serial_controller(config: StationConfig) -> SerialController:
    """The controller of `[controller]`; DeviceError says why it cannot be used."""
    return SerialController(config.controller)


class SerialController:
    """A `Controller`; opened, identified and disarmed when it has been made."""

    def __init__(self, config: ControllerConfig) -> None:
        self._waker = Waker()
        self._supervisor = Supervisor(config, self._waker)
        self._broken: DeviceError | None = None
        """What a job has found broken."""
        self._jobs: SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = SimpleQueue()
        self._backoff = Backoff(PACE)
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None
        try:
            self._supervisor.connect()
        except BaseException:  # whatever ended it, tidy up; it is raised again
            self._release()
            raise

    def start(self, events: EventQueue) -> None:
        """Begin to report events."""
        self._supervisor.publish_reading = events.put
        self._supervisor.translator.start(events.put)
        self._thread = threading.Thread(target=self._work, name="controller")
        self._thread.start()

    def arm(self, plan: TriggerPlan) -> None:
        """From now on every passage of the barrier is a run with this plan."""
        self._do(lambda: self._supervisor.arm(plan))

    def disarm(self) -> None:
        """Ignore the barrier; without a line, the controller will be disarmed when it is there again."""
        supervisor = self._supervisor
        with supervisor.lock:
            supervisor.guard_tripped = False
            if supervisor.unavailable is not None:
                supervisor.drop_arming()
                return
        try:
            self._do(supervisor.disarm)
        except DeviceError:  # it broke just now, and is told by the thread that mends it
            with supervisor.lock:
                supervisor.drop_arming()

    def fire_one(self) -> None:
        """Trigger all cameras and LEDs once."""
        self._do(self._supervisor.fire_one)

    def read_clock(self) -> ClockReading:
        """Compare clocks."""
        return self._do(self._supervisor.read_clock)

    def health(self) -> str:
        """What it is and does, and how well the line is."""
        supervisor, link, ident = self._supervisor, self._supervisor.link, self.ident
        state = "not reachable" if supervisor.unavailable else "armed" if supervisor.arming else "idle"
        barrier = ", barrier interrupted" if link.status is not None and link.status.blocked else ""
        firmware = f"{ident.firmware_major}.{ident.firmware_minor}.{ident.firmware_patch}"
        noise = f"{link.bad_frames} bad frames, {link.retries} repeats, {link.unmatched} strays"
        clock = f"clock ± {self.clock_bound_s * 1e3:.2f} ms, {supervisor.timebase.drift_ppm():+.1f} ppm"
        return f"serial: {state}{barrier}, firmware {firmware}, start {link.boots}, {clock}, {noise}"

    @property
    def ident(self) -> Ident:
        """Who it is: versions, limits, start number."""
        return self._supervisor.ident

    @property
    def clock_bound_s(self) -> float:
        """How well its clock is known."""
        return self._supervisor.timebase.bound_s()

    def close(self) -> None:
        """Disarm, then close the port."""
        self.disarm()
        with self._supervisor.lock:
            self._closing.set()
            self._waker.wake()
        if self._thread is not None:
            self._thread.join()
        self._release()

    def _do(self, job: Callable[[], T]) -> T:
        """Let the thread do it; DeviceError at once while the line is down."""
        if self._thread is None:
            return job()
        with self._supervisor.lock:
            if (down := self._supervisor.unavailable) is not None:
                raise DeviceError(down.message, action=down.action, code=down.code)
            future: Future[T] = Future()
            self._jobs.put((lambda: self._try(job), future))
            self._waker.wake()
        return future.result()

    # --- the thread that talks

    def _work(self) -> None:
        try:
            self._keep_at_it()
        finally:
            self._lose(DeviceError("The controller is not attended to any more.", action="Restart the station."))

    def _keep_at_it(self) -> None:
        while not self._closing.is_set():
            try:
                if self._supervisor.unavailable is not None:
                    self._backoff.start_attempt()
                    self._supervisor.connect()
                self._backoff.record_success()
                self._serve()
            except ResetError as error:  # told when it is known what it cost
                self._lose(error)
            except DeviceError as error:
                self._supervisor.translator.report_fault(error)
                self._lose(error)
                self._supervisor.disconnect()
                self._closing.wait(self._backoff.record_failure())

    def _serve(self) -> None:
        """Until something breaks: carry out what is asked, hear what comes."""
        self._broken = None
        while not self._closing.is_set():
            try:
                job, future = self._jobs.get_nowait()
            except Empty:
                self._supervisor.poll()
            else:
                _carry_out(job, future)
                if self._broken is not None:
                    raise self._broken

    def _try(self, job: Callable[[], T]) -> T:
        """A job that finds the line broken ends the serving as well."""
        try:
            return job()
        except RefusalError:
            raise
        except DeviceError as error:
            self._broken = error
            raise

    def _lose(self, error: DeviceError) -> None:
        """Whoever waits is told, and whoever asks from now on."""
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


def _carry_out(job: Callable[[], Any], future: Future[Any]) -> None:
    try:
        future.set_result(job())
    except BaseException as error:  # noqa: BLE001  (whoever asked gets it, whatever it is)
        future.set_exception(error)
