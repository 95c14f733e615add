"""The devices of a station whose frames come from the sender process; the controller keeps a film's own pace."""

from __future__ import annotations

import multiprocessing
import threading
import time
from collections import deque
from collections.abc import Iterator
from functools import partial
from itertools import count, repeat
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from vaoi_station.acquisition.cameras.interface import Arrival, CameraEvent, CameraHealth, Slot
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.replay import RecordedRow, ReplayController
from vaoi_station.acquisition.device_clock import DeviceClock
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.process.main_loop import run_acquisition
from vaoi_station.benchmarks.film import Film
from vaoi_station.benchmarks.sender import Order
from vaoi_station.config import StationConfig
from vaoi_station.runs.control.acquisition_link import Launch, Process
from vaoi_station.runs.host.process_setup import set_up_process

if TYPE_CHECKING:
    Pipe = Connection[Any, Any]


class Feed:
    """The wires to the sender: orders go out, filled slots come back and are announced."""

    def __init__(self, connection: Pipe) -> None:
        self._connection = connection
        self._underway: dict[int, tuple[int, float]] = {}
        """Frame id and time stamp by slot."""
        self._sending = threading.Lock()
        self._arrivals: SimpleQueue[CameraEvent] | None = None

    def listen(self, arrivals: SimpleQueue[CameraEvent]) -> None:
        """Begin to announce what arrives; asked by every camera, the first one counts."""
        if self._arrivals is None:
            self._arrivals = arrivals
            threading.Thread(target=self._listen, name="feed", daemon=True).start()

    def order(self, order: Order, frame_id: int, time_s: float) -> None:
        """Have a slot filled."""
        self._underway[order.slot] = frame_id, time_s
        with self._sending:
            self._connection.send(order)

    def _listen(self) -> None:
        assert self._arrivals is not None
        while True:
            try:
                order: Order = self._connection.recv()
            except (EOFError, OSError):
                return  # the benchmark is over
            frame_id, time_s = self._underway.pop(order.slot)
            self._arrivals.put(Arrival(order.camera, order.slot, True, frame_id, time_s, time.monotonic()))


class FedCamera:
    """A `CameraDevice` that has its slots filled by the sender."""

    def __init__(self, number: int, clock: DeviceClock, feed: Feed) -> None:
        self.number = number
        self._clock, self._feed = clock, feed
        self._slots: deque[Slot] = deque()
        self._ids = count(1)
        self._delivered = self._starved = 0

    def start(self, arrivals: SimpleQueue[CameraEvent]) -> None:
        """Begin to deliver."""
        self._feed.listen(arrivals)

    def trigger(self, row: int, time_s: float) -> None:
        """The controller fires."""
        frame_id = next(self._ids)
        try:
            slot = self._slots.popleft()
        except IndexError:
            self._starved += 1
            return
        self._delivered += 1
        self._feed.order(Order(self.number, row, slot.number), frame_id, time_s)

    def queue(self, slot: Slot) -> None:
        """Offer memory for a coming frame."""
        self._slots.append(slot)

    def take_back(self) -> list[int]:
        """Withdraw the slots that were not used."""
        numbers = [slot.number for slot in self._slots]
        self._slots.clear()
        return numbers

    def read_clock(self) -> ClockReading:
        """Its clock is the controller's."""
        return self._clock.read_exactly()

    def health(self) -> CameraHealth:
        """Counts of what was delivered."""
        message = f"{self._starved} frames found no memory" if self._starved else ""
        return CameraHealth(True, message, None, self._delivered)

    def close(self) -> None:
        """Nothing is held: the feed ends with its pipe."""


def fed_devices(film: Film, rate: float, pause_s: float, connection: Pipe, _: StationConfig) -> Devices:
    """Cameras and controller; the film is played so many times as fast as it was filmed, over and over."""
    clock, feed, head = DeviceClock(), Feed(connection), film.head
    cameras = tuple(FedCamera(n, clock, feed) for n in range(len(head.cameras)))

    def show(row: int, time_s: float) -> int:
        for camera in cameras:
            camera.trigger(row, time_s)
        return len(cameras)

    times_s = head.row_times_s() / rate
    rows = [
        RecordedRow(
            round(float(times_s[row] - times_s[0]), 9), head.lights[row] if head.lights else "", (), partial(show, row)
        )
        for row in range(head.rows)
    ]
    runs: Iterator[list[RecordedRow]] = repeat(rows)
    return Devices(cameras, ReplayController(runs, clock, pause_s, None))


def launched(config: StationConfig, ring: Path, film: Film, rate: float, pause_s: float, connection: Pipe) -> Launch:
    """Starts the acquisition process with these devices."""

    def launch() -> tuple[Process, Pipe]:
        spawn = multiprocessing.get_context("spawn")
        here, there = spawn.Pipe()
        connection.send(str(ring))
        arguments = (config, str(ring), there, film, rate, pause_s, connection)
        process = spawn.Process(target=_acquire, args=arguments, name="vaoi-acquisition", daemon=True)
        process.start()
        there.close()
        return process, here

    return launch


def _acquire(
    config: StationConfig, ring: str, connection: Pipe, film: Film, rate: float, pause_s: float, feed: Pipe
) -> None:
    set_up_process(one_thread=False)
    run_acquisition(config, Path(ring), connection, partial(fed_devices, film, rate, pause_s, feed))
