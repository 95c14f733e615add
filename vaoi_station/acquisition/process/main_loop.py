"""The acquisition process: one inbox and one loop; devices deliver into the inbox from their own threads.

The station starts the process and communicates with it over one pipe; a single thread takes all decisions. A process
may be held up for a second while frames that arrived in time lie in the inbox, so deadlines are compared with the
inbox's time. When the pipe ends, the process closes its devices; when a device fails, it reports this and continues.
"""

from __future__ import annotations

import contextlib
import logging
import math
import multiprocessing
import queue
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import Connection, wait
from pathlib import Path
from time import monotonic
from typing import Any

from vaoi_station.acquisition.cameras.interface import Arrival, CameraBack, CameraDevice, CameraLost, DeviceFault
from vaoi_station.acquisition.clocks import ClockError, ClockModel, ClockReading, apart_s
from vaoi_station.acquisition.controller.interface import Controller, ControllerEvent, RunEnded
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.process.backends import open_devices
from vaoi_station.acquisition.process.messages import (
    Arm,
    Disarm,
    EndTrial,
    FireOne,
    FireTrial,
    Grant,
    Health,
    OfferBoard,
    PermitBoard,
    Ready,
    ReplaceCamera,
    Shutdown,
    TrialFailed,
)
from vaoi_station.acquisition.process.passages import PassageWatch
from vaoi_station.acquisition.process.run_reports import clock_jump_error, trouble_report
from vaoi_station.acquisition.process.session import Session
from vaoi_station.acquisition.ring import Ring, RingLayout
from vaoi_station.config import StationConfig
from vaoi_station.errors import InternalError, StateError, VaoiError
from vaoi_station.supervised_thread import SupervisedThread, ThreadFault, faults_of

HELD_UP_S = 0.1
"""A wait or a message that takes longer shows that the process was held up. Threads of devices, which probably were as
well, are then given this time to deliver."""
LONGEST_LAG_S = 2.0
"""Largest lag of the inbox's time behind the clock, if messages come without a pause."""


class Inbox:
    """A queue of messages of several threads, which one thread takes."""

    def __init__(self) -> None:
        self.messages: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.taken_until_s = self._returned_s = monotonic()
        """Time up to which all messages were taken, by time.monotonic()."""
        self._held_up = False

    def take(self, until_s: float) -> Any:
        """Wait for a message until the given time of time.monotonic(), and return it; None if none came.

        If the process was held up, the wait lasts at least `HELD_UP_S`.
        """
        now_s = monotonic()
        if self._held_up or now_s > self._returned_s + HELD_UP_S:
            until_s = max(until_s, now_s + HELD_UP_S)
        until_s = max(until_s, now_s)
        try:
            message = self.messages.get(timeout=until_s - now_s)
        except queue.Empty:
            message = None
        self._returned_s = monotonic()
        self._held_up = self._returned_s > until_s + HELD_UP_S
        # The time was read first: a message that comes between the two lines was put after it.
        if self.messages.empty() and not self._held_up:
            self.taken_until_s = self._returned_s
        self.taken_until_s = max(self.taken_until_s, self._returned_s - LONGEST_LAG_S)
        return message


_log = logging.getLogger(__name__)

HEALTH_PERIOD_S = 0.5
CLOCKS_LIMIT_S = 30.0
"""Longest time for the reading of one clock. After it, the thread that reads the clocks counts as hung, s."""
END_S = 3.0
FIRST_READINGS = 8
URGENT_READING_PERIOD_S = 0.05
"""Shortest time between two readings of all clocks, while a command or the end of a run waits for them, s."""
CLOCK_TIMEOUT_S = 10.0
"""Longest time for which arming or a single pulse waits until the clocks are known accurately enough, s."""
# On a busy computer most round trips are long, but a single short one is enough.


def run_acquisition(
    config: StationConfig,
    ring_path: Path,
    connection: Connection,
    open_backend: Callable[[StationConfig], Devices] = open_devices,
) -> None:
    """Run the acquisition process until `Shutdown`, or until the other end of the pipe is closed."""
    if multiprocessing.parent_process() is not None and threading.current_thread() is threading.main_thread():
        # Ctrl-C reaches all processes of the group. Only the station reacts to it, by sending Shutdown.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with Ring.attach(ring_path, writable=True) as ring:
            _check_layout(ring, config)
            devices = open_backend(config)
            try:
                _MainLoop(config, ring, devices, connection).run()
            except InternalError as error:
                _report_failure(connection, error)
                _close_within(devices, END_S)
            except BaseException:  # any other end closes the devices too; raised again
                devices.close()
                raise
            else:
                devices.close()
    except VaoiError as error:
        _report_failure(connection, error)
    except (BrokenPipeError, ConnectionResetError):
        pass  # the station is gone; no process is left to report to
    finally:
        connection.close()


_DISARMED = object()
"""A marker in the inbox: all events from before the controller was disarmed are in front of it."""
_Command = Grant | Arm | FireOne | FireTrial | EndTrial | Disarm | PermitBoard | OfferBoard | ReplaceCamera


@dataclass(frozen=True)
class _PolledClock:
    """The reading of a device's clock, or the error of the attempt. Number 0 is the controller; 1, 2, … are cameras."""

    number: int
    result: ClockReading | VaoiError


class _MainLoop:
    def __init__(self, config: StationConfig, ring: Ring, devices: Devices, connection: Connection) -> None:
        self._devices, self._connection, self._send = devices, connection, connection.send
        self._inbox, self._cameras = Inbox(), config.cameras
        self._clocks = [ClockModel("controller"), *(ClockModel(c.label) for c in config.cameras)]
        self._session = Session(config, ring, devices, self._clocks[0], self._clocks[1:], connection.send)
        self._sources: list[Controller | CameraDevice] = [devices.controller, *devices.cameras]
        self._closing, self._clocks_wanted = threading.Event(), threading.Event()
        self._disarm_by_s = math.inf
        """Time by which a requested Disarm is carried out at the latest; infinite without a request."""
        self._threads: tuple[SupervisedThread, ...] = ()
        self._failures: list[ThreadFault] = []
        self._waiting: tuple[Arm | FireOne | FireTrial, float] | None = None
        """A command that waits until the models of all clocks are accurate enough, and until when it does."""
        self._health_is_due = False
        """Whether a device was lost or is back, or a board came or left: the next heartbeat is sent at once."""
        self._passage = PassageWatch()
        self._apart: set[int] = set()
        """Cameras with PTP whose clocks differ from the others."""

    def run(self) -> None:
        """Start the devices, then handle one message after another until `Shutdown`."""
        if multiprocessing.parent_process() is not None:
            # Threads of cameras and controller report errors themselves; one that ends by another error is noticed too.
            threading.excepthook = self._note_failure
        for camera in self._devices.cameras:
            camera.start(self._inbox.messages)
        self._devices.controller.start(self._inbox.messages)
        cameras = [*zip(self._clocks[1:], self._devices.cameras, strict=True)]
        for _ in range(FIRST_READINGS):
            self._clocks[0].add(self._devices.controller.read_clock())
            for clock, camera in cameras[:]:
                # A camera that is lost from the start reports that itself, and its clock when it is back. It is not
                # asked again, since each reading of a silent camera takes seconds.
                try:
                    clock.add(camera.read_clock())
                except VaoiError:
                    cameras.remove((clock, camera))
        woken, waker = multiprocessing.Pipe(duplex=False)
        commands = SupervisedThread(partial(self._receive_commands, woken), "commands")
        self._clock_thread = SupervisedThread(self._poll_clocks, "clocks", CLOCKS_LIMIT_S)
        self._threads = (commands, self._clock_thread)
        for thread in self._threads:
            thread.start()
        try:
            self._send(Ready(len(self._devices.cameras)))
            self._process_inbox()
        finally:
            self._closing.set()
            self._clocks_wanted.set()
            # Closing the pipe wakes the thread that waits for commands: a blocked recv cannot be interrupted.
            waker.close()
            for thread in self._threads:
                thread.join(END_S)
            woken.close()

    def _process_inbox(self) -> None:
        health_s = ticked_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            if now_s >= health_s or self._health_is_due:
                self._health_is_due = False
                # A lost thread ends the process, and the station restarts it.
                for fault in (*self._failures, *faults_of((*self._threads, *self._devices.threads()))):
                    raise InternalError(f"In the acquisition process: {fault}", code="thread-lost")
                self._send(self._health(now_s))
                health_s = now_s + HEALTH_PERIOD_S
            if (taken_s := self._inbox.taken_until_s) >= self._session.deadline_s(ticked_s):
                self._session.tick(taken_s)
                ticked_s = taken_s
            item = self._inbox.take(min(health_s, self._session.deadline_s(ticked_s)))
            if isinstance(item, Shutdown):
                return
            if item is not None:
                self._try(partial(self._handle, item))
            # This is tried after every item, because the item may be the clock reading that the command waits for.
            self._try(self._retry_waiting)
            self._try(self._disarm_when_due)
            # An event that waits in the inbox may be the report of a pulse, during which no camera may be stopped.
            if self._inbox.messages.empty():
                self._try(self._session.rewind_sequences)
            if isinstance(item, RunEnded) or self._session.awaits_clocks:
                self._clocks_wanted.set()

    def _note_failure(self, failure: threading.ExceptHookArgs) -> None:
        name = failure.thread.name if failure.thread else "?"
        _log.critical("thread %s has ended", name, exc_info=failure.exc_value)
        self._failures.append(ThreadFault(name, f"has ended ({failure.exc_type.__name__}: {failure.exc_value})"))

    def _try(self, step: Callable[[float], None]) -> None:
        try:
            step(time.monotonic())
        except VaoiError as error:
            self._send(trouble_report(error))

    def _handle(self, item: object, now_s: float) -> None:
        if isinstance(item, Arrival):
            self._session.handle_arrival(item, now_s, self._inbox.taken_until_s)
        elif isinstance(item, ControllerEvent):
            self._health_is_due |= self._passage.add(item, now_s)
            self._session.handle_event(item, now_s)
        elif isinstance(item, _Command):
            self._obey(item, now_s)
        elif item is _DISARMED:
            self._passage.disarm()
            self._session.finish_disarming(now_s)
        elif isinstance(item, CameraLost):
            self._session.outages.begin(item.camera, item.since_s, item.why)
            self._send(trouble_report(item.error))
            self._health_is_due = True
        elif isinstance(item, CameraBack):
            self._clocks[1 + item.camera].add(item.reading)  # First: it dates the next arrival of a restarted clock.
            self._session.outages.end(item.camera, item.at_s)
            self._session.sequences.forget(item.camera)
            self._session.trial.camera_back()
            self._health_is_due = True
        elif isinstance(item, DeviceFault):
            if item.error.code == "events-lost":
                self._passage.forget_barrier()
            self._session.announced.lose(item.error.code)
            self._send(trouble_report(item.error, item.device))
            self._health_is_due = True
        elif isinstance(item, ClockReading):
            self._clocks[0].add(item)
        elif isinstance(item, _PolledClock):
            self._add_polled(item)
            if self._session.awaits_clocks:
                self._session.tick(now_s)
        else:
            raise InternalError(f"the acquisition process has no handler for {item!r}.")

    def _obey(self, command: _Command, now_s: float) -> None:
        if isinstance(command, Grant):
            self._session.grant(command)
        elif isinstance(command, PermitBoard):
            self._devices.controller.permit_board(command.permit)
        elif isinstance(command, OfferBoard):
            self._devices.controller.offer_board(command.offer)
        elif isinstance(command, ReplaceCamera):
            self._session.note_serial(command.camera, command.serial)
            self._devices.cameras[command.camera].replace(command.serial, command.address)
        elif isinstance(command, EndTrial):
            self._session.trial.restore()
        elif isinstance(command, Disarm):
            self._replace_waiting(None)
            plan = self._session.plan
            self._disarm_by_s = min(self._disarm_by_s, now_s + (plan.grace_s if plan is not None else 0.0))
        else:
            self._replace_waiting((command, now_s + CLOCK_TIMEOUT_S))

    def _replace_waiting(self, waiting: tuple[Arm | FireOne | FireTrial, float] | None) -> None:
        """Let another command wait, or none. A trial that waited is refused."""
        if self._waiting is not None and isinstance(self._waiting[0], FireTrial):
            why = trouble_report(StateError("the line is being armed.", action="Disarm it."))
            self._send(TrialFailed(self._waiting[0].grant.run, why))
        self._waiting = waiting

    def _add_polled(self, polled: _PolledClock) -> None:
        clock = self._clocks[polled.number]
        # The loss of a camera has been reported already. A second report would end an arming that succeeds without it.
        if isinstance(polled.result, ClockReading):
            jump = clock.add(polled.result)
            if jump is not None and polled.number > 0:
                self._session.outages.add_jump(polled.number - 1, jump)
                # A jump before the line is armed harms no board. Reported as trouble it would end the arming. A camera
                # with PTP is set to the time of its master, which may come late; that costs nothing between two boards.
                in_a_run = self._session.filming or self._session.awaits_clocks or bool(self._passage.passing)
                if self._cameras[polled.number - 1].ptp and not in_a_run:
                    _log.info("%s: %s, as its PTP master has set it", clock.name, jump)
                elif self._waiting is None:
                    self._send(trouble_report(clock_jump_error(clock.name, jump)))
        elif not self._session.is_away(polled.number):
            self._send(trouble_report(polled.result, clock.name))

    def _disarm_when_due(self, now_s: float) -> None:
        """Disarm the controller if that was requested and no board is passing, or the board has not left in time."""
        if math.isinf(self._disarm_by_s) or (self._session.filming and now_s < self._disarm_by_s):
            return
        self._disarm_by_s = math.inf
        self._devices.controller.disarm()
        # When disarm() returns, all events of the controller are in the inbox; the marker comes after them.
        self._inbox.messages.put(_DISARMED)

    def _retry_waiting(self, now_s: float) -> None:
        """Carry out the waiting command if the clocks are accurate enough. Raise ClockError after its longest wait."""
        if (waiting := self._waiting) is None:
            return
        (command, until_s), self._waiting = waiting, None
        try:
            if isinstance(command, FireTrial):
                self._session.fire_trial(command, now_s)
            elif isinstance(command, FireOne):
                self._session.fire_one(now_s)
            elif self._session.trial.is_under_way:
                self._waiting = waiting  # until its frames have come: the first board needs the cameras
            else:
                self._session.arm(command.plan)
                self._passage.arm(command.plan, self._devices.controller.barrier_blocked())
                self._health_is_due = True
        except VaoiError as error:
            if isinstance(error, ClockError) and now_s < until_s:
                self._waiting = waiting
            elif isinstance(command, FireTrial):
                self._send(TrialFailed(command.grant.run, trouble_report(error)))
            else:
                raise

    def _health(self, now_s: float) -> Health:
        cameras = [camera.health() for camera in self._devices.cameras]
        follow = {k: seen.ptp for k, seen in enumerate(cameras) if seen.ptp and seen.ptp.synchronised}
        clocks = {k: (self._clocks[1 + k], ptp.epoch_ns) for k, ptp in follow.items()}
        apart = {k: off_s for k, off_s in apart_s(clocks, now_s).items() if off_s}
        for k, off_s in apart.items():
            cameras[k] = replace(cameras[k], ptp=replace(follow[k], apart_s=off_s))
        if apart.keys() != self._apart:
            named = ", ".join(f"{self._clocks[1 + k].name} by {off_s * 1e3:+.3f} ms" for k, off_s in apart.items())
            _log.warning("clocks of cameras with PTP that differ from the others: %s", named or "none any more")
            self._apart = set(apart)
        controller = self._devices.controller
        self._passage.check_level(controller.barrier_blocked(), now_s)
        return Health(
            tuple(cameras),
            controller.health(),
            now_s,
            controller_ready=controller.is_watching(),
            line_output=controller.line_output(),
            contacts=controller.contacts(),
            passing=self._passage.passing,
            belt_stopped=self._passage.belt_stopped(now_s),
            limits=controller.limits(),
            standing=self._passage.standing,
        )

    def _receive_commands(self, woken: Connection) -> None:
        command: object = None
        while not isinstance(command, Shutdown):
            self._threads[0].rest()
            if woken in wait([self._connection, woken]):
                break
            self._threads[0].beat()
            try:
                command = self._connection.recv()
            except (EOFError, OSError):
                command = Shutdown()
            self._inbox.messages.put(command)
        self._threads[0].expect_end()

    def _poll_clocks(self) -> None:
        """Read all clocks twice a second, and more often while a command or the end of a run waits for them."""
        # This runs in a separate thread: the control channel of a dead Aravis camera blocks for about 2.6 s.
        while not self._closing.wait(URGENT_READING_PERIOD_S):
            if not self._waiting:
                self._clocks_wanted.wait(HEALTH_PERIOD_S - URGENT_READING_PERIOD_S)
            self._clocks_wanted.clear()
            for number, source in enumerate(self._sources):
                self._clock_thread.beat()
                result: ClockReading | VaoiError
                try:
                    result = source.read_clock()
                except VaoiError as error:
                    result = error
                self._inbox.messages.put(_PolledClock(number, result))
        self._clock_thread.expect_end()


def _close_within(devices: Devices, longest_s: float) -> None:
    # A thread that hangs may keep its device from closing.
    closing = threading.Thread(target=devices.close, name="closing", daemon=True)
    closing.start()
    closing.join(longest_s)


def _check_layout(ring: Ring, config: StationConfig) -> None:
    if ring.layout != RingLayout.of(config):
        raise StateError(f"{ring.path}: was created for another configuration.", action="Restart the station.")


def _report_failure(connection: Connection, error: VaoiError) -> None:
    with contextlib.suppress(OSError):  # the station is gone; no process is left to report to
        connection.send(trouble_report(error))
