"""The controller at a serial port. One thread uses the port; other threads give it jobs through a queue."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.interface import ControllerLimits, EventQueue, LineOutput, Permit, TriggerPlan
from vaoi_station.acquisition.controller.protocol.messages import Hold, Ident
from vaoi_station.acquisition.controller.serial.device_program import firmware_limits
from vaoi_station.acquisition.controller.serial.exchange import RefusalError, ResetError
from vaoi_station.acquisition.controller.serial.port import Waker
from vaoi_station.acquisition.controller.serial.supervisor import Supervisor
from vaoi_station.backoff import Backoff, BackoffPolicy
from vaoi_station.config import ControllerConfig, StationConfig
from vaoi_station.errors import DeviceError
from vaoi_station.supervised_thread import DEVICE_LIMIT_S, SupervisedThread

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
    """Open the controller of `[controller]` in station.toml.

    Raises:
        DeviceError: the controller cannot be used; the message says why.
    """
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
        """Let the controller's thread do a job, and wait for its outcome.

        Raise DeviceError at once if it is not reachable.
        """
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
