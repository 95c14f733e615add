"""The acquisition process: one inbox, one loop; everything else happens in threads of devices.

The station starts it with `spawn` and talks to it over one pipe. Commands, controller events, arrivals,
clock readings and faults meet in one queue, so that the loop is the only one to think. When the pipe ends
it closes its devices and goes; when a device fails it says so and stays.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import queue
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from vaoi_station.acquisition.cameras.interface import Arrival, CameraBack, CameraDevice, CameraLost, DeviceFault
from vaoi_station.acquisition.clocks import ClockError, ClockModel, ClockReading
from vaoi_station.acquisition.controller.interface import Controller, ControllerEvent
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.process.backends import open_devices
from vaoi_station.acquisition.process.messages import Arm, Disarm, FireOne, Grant, Health, Ready, Report, Shutdown
from vaoi_station.acquisition.process.run_reports import trouble
from vaoi_station.acquisition.process.session import Session
from vaoi_station.acquisition.ring.ring import Ring, RingLayout
from vaoi_station.config import StationConfig
from vaoi_station.errors import InternalError, StateError, VaoiError

HEALTH_S = 0.5
FIRST_READINGS = 8
"""Clock readings before the process is ready."""
HURRY_S = 0.05
"""Between readings while somebody waits for them."""
CLOCK_PATIENCE_S = 10.0
"""So long an arming or a single pulse waits until the clocks are known well enough. On a busy computer round trips
are long, and a short one decides."""


def run_acquisition(
    config: StationConfig,
    ring_path: Path,
    connection: Connection,
    open_them: Callable[[StationConfig], Devices] = open_devices,
) -> None:
    """Film until told to stop, or until the other end of the pipe is gone; `open_them` gives the devices."""
    if multiprocessing.parent_process() is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the station's to answer, by Shutdown
    try:
        with Ring.attach(ring_path, writable=True) as ring:
            _check_layout(ring, config)
            devices = open_them(config)
            try:
                _Loop(config, ring, devices, connection).run()
            finally:
                devices.close()
    except VaoiError as error:
        _last_words(connection, error)
    except (BrokenPipeError, ConnectionResetError):
        pass  # the station is gone; there is nobody to tell
    finally:
        connection.close()


class _Disarmed:
    """Put into the inbox behind the last event of an armed controller."""


@dataclass(frozen=True)
class _Waiting:
    """A command that waits for clocks to be known."""

    command: Arm | FireOne
    until_s: float


@dataclass(frozen=True)
class _Asked:
    """What a device, the controller (0) or a camera (from 1), answered when asked for its time, or why it did not."""

    number: int
    answer: ClockReading | VaoiError


class _Loop:
    def __init__(self, config: StationConfig, ring: Ring, devices: Devices, connection: Connection) -> None:
        self._devices, self._connection = devices, connection
        self._inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._clocks = [ClockModel("controller"), *(ClockModel(c.label) for c in config.cameras)]
        self._session = Session(config, ring, devices, self._clocks[0], self._clocks[1:], connection.send)
        self._sources: list[Controller | CameraDevice] = [devices.controller, *devices.cameras]
        self._closing = threading.Event()
        self._waiting: _Waiting | None = None

    def run(self) -> None:
        """Start the devices, then think about one message after another."""
        for camera in self._devices.cameras:
            camera.start(self._inbox)
        self._devices.controller.start(self._inbox)
        for _ in range(FIRST_READINGS):
            self._read_clocks()
        woken, waker = multiprocessing.Pipe(duplex=False)
        threads = [
            threading.Thread(target=self._listen, args=(woken,), name="commands"),
            threading.Thread(target=self._watch_clocks, name="clocks"),
        ]
        for thread in threads:
            thread.start()
        try:
            self._send(Ready(len(self._devices.cameras)))
            self._think()
        finally:
            self._closing.set()
            waker.close()
            for thread in threads:
                thread.join()
            woken.close()

    def _think(self) -> None:
        health_s = ticked_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            if now_s >= health_s:
                self._send(self._health(now_s))
                health_s = now_s + HEALTH_S
            if now_s >= self._session.deadline_s(ticked_s):
                self._session.tick(now_s)
                ticked_s = now_s
            try:
                item = self._inbox.get(timeout=min(health_s, self._session.deadline_s(ticked_s)) - now_s)
            except queue.Empty:
                item = None
            if isinstance(item, Shutdown):
                return
            if item is not None:
                self._try(partial(self._handle, item))
            self._try(self._obey)

    def _try(self, step: Callable[[float], None]) -> None:
        """Do something now; what it refuses is told."""
        try:
            step(time.monotonic())
        except VaoiError as error:
            self._send(trouble(error))

    def _handle(self, item: object, now_s: float) -> None:
        if isinstance(item, Arrival):
            self._session.arrived(item, now_s)
        elif isinstance(item, ControllerEvent):
            self._session.heard(item, now_s)
        elif isinstance(item, Grant):
            self._session.grant(item)
        elif isinstance(item, Arm | FireOne):
            self._waiting = _Waiting(item, now_s + CLOCK_PATIENCE_S)
        elif isinstance(item, Disarm):
            self._waiting = None
            self._devices.controller.disarm()
            self._inbox.put(_Disarmed())
        elif isinstance(item, _Disarmed):
            self._session.disarmed(now_s)
        elif isinstance(item, CameraLost):
            self._session.lost(item)
            self._send(trouble(item.error))
        elif isinstance(item, CameraBack):
            self._clocks[1 + item.camera].add(item.reading)
            self._session.back(item)
        elif isinstance(item, DeviceFault):
            self._send(trouble(item.error, item.device))
        elif isinstance(item, ClockReading):
            self._clocks[0].add(item)
        elif isinstance(item, _Asked):
            self._note_time(item)
        else:
            raise InternalError(f"the acquisition process was told {item!r}, which it does not know.")

    def _note_time(self, asked: _Asked) -> None:
        """That a lost camera does not answer has been told, and must not end an arming that does without it."""
        clock = self._clocks[asked.number]
        if isinstance(asked.answer, ClockReading):
            clock.add(asked.answer)
        elif not self._session.is_away(asked.number):
            self._send(trouble(asked.answer, clock.name))

    def _obey(self, now_s: float) -> None:
        """Arm, or fire, once the clocks are known well enough; ClockError if they are not in time."""
        waiting, self._waiting = self._waiting, None
        if waiting is None:
            return
        try:
            if isinstance(waiting.command, Arm):
                self._session.arm(waiting.command.plan)
            else:
                self._session.fire_one(now_s)
        except ClockError:
            if now_s >= waiting.until_s:
                raise
            self._waiting = waiting

    def _send(self, report: Report) -> None:
        self._connection.send(report)

    def _health(self, now_s: float) -> Health:
        cameras = tuple(camera.health() for camera in self._devices.cameras)
        return Health(cameras, self._devices.controller.health(), now_s)

    def _listen(self, woken: Connection) -> None:
        """Commands into the inbox; the end of the pipe is a Shutdown."""
        command: object = None
        while not isinstance(command, Shutdown):
            if woken in wait([self._connection, woken]):
                return
            try:
                command = self._connection.recv()
            except (EOFError, OSError):
                command = Shutdown()
            self._inbox.put(command)

    def _watch_clocks(self) -> None:
        """Readings twice a second, from a thread of their own: a camera that is gone lets one wait for seconds.

        While a command waits for them they follow one another at once.
        """
        while not self._closing.wait(HURRY_S if self._waiting else HEALTH_S):
            for number, source in enumerate(self._sources):
                try:
                    self._inbox.put(_Asked(number, source.read_clock()))
                except VaoiError as error:
                    self._inbox.put(_Asked(number, error))

    def _read_clocks(self) -> None:
        for clock, source in zip(self._clocks, self._sources, strict=True):
            clock.add(source.read_clock())


def _check_layout(ring: Ring, config: StationConfig) -> None:
    if ring.layout != RingLayout.of(config):
        raise StateError(f"{ring.path}: was made for another configuration.", action="Restart the station.")


def _last_words(connection: Connection, error: VaoiError) -> None:
    with contextlib.suppress(OSError):  # the station is gone; there is nobody to tell
        connection.send(trouble(error))
