"""Camera and controller devices for an acquisition process whose frames come from the sender process."""

from __future__ import annotations

import multiprocessing
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import count, repeat
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from vaoi_station.acquisition.cameras.interface import Arrival, CameraEvent, CameraExposure, CameraHealth, Slot
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.replay import RecordedRow, ReplayController
from vaoi_station.acquisition.device_clock import DeviceClock
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.process.main_loop import run_acquisition
from vaoi_station.benchmarks.station.frame_sender import FillRequest
from vaoi_station.benchmarks.station.prerendered_run import PrerenderedRun
from vaoi_station.config import StationConfig
from vaoi_station.runs.control.acquisition_link import Launch, Process
from vaoi_station.runs.host.process_setup import set_up_process
from vaoi_station.supervised_thread import SupervisedThread

if TYPE_CHECKING:
    Pipe = Connection[Any, Any]


@dataclass(frozen=True)
class Playback:
    """A prerendered run that passes again and again.

    Attributes:
        run: the frames and their trigger times.
        rate: factor on the trigger rate of the prerendered run.
        pause_s: pause between two passes.
    """

    run: PrerenderedRun
    rate: float
    pause_s: float


class SenderConnection:
    """Connection from the acquisition process to the sender: it sends requests and turns replies into arrivals."""

    def __init__(self, connection: Pipe) -> None:
        self._connection = connection
        self._pending: dict[int, tuple[int, float]] = {}
        """Slot → frame id and time stamp of its arrival, for requests without a reply."""
        self._sending = threading.Lock()
        self._arrivals: SimpleQueue[CameraEvent] | None = None
        self.thread = SupervisedThread(self._receive, "sender-replies")
        """The thread that receives the replies."""

    def start(self, arrivals: SimpleQueue[CameraEvent]) -> None:
        """Start to put arrivals into a queue. Each camera calls this method; only the first call has an effect."""
        if self._arrivals is None:
            self._arrivals = arrivals
            self.thread.start()

    def request(self, request: FillRequest, frame_id: int, time_s: float) -> None:
        """Request that the sender fills a slot. The arrival of the frame will have the given id and time stamp."""
        # Stored before the request is sent: the other thread may receive the reply before `send` returns.
        self._pending[request.slot] = frame_id, time_s
        with self._sending:
            self._connection.send(request)

    def _receive(self) -> None:
        assert self._arrivals is not None
        while True:
            try:
                with self.thread.waiting():
                    request: FillRequest = self._connection.recv()
            except (EOFError, OSError):
                self.thread.expect_end()
                # The sender ends with the benchmark; there is nothing left to deliver.
                return
            frame_id, time_s = self._pending.pop(request.slot)
            self._arrivals.put(Arrival(request.camera, request.slot, True, frame_id, time_s, time.monotonic()))


class SenderCamera:
    """A `CameraDevice` whose slots are filled by the sender process."""

    def __init__(self, number: int, clock: DeviceClock, sender: SenderConnection) -> None:
        self.number = number
        self._clock, self._sender = clock, sender
        self._slots: deque[Slot] = deque()
        self._ids = count(1)
        self._delivered = self._without_slot = 0

    def start(self, arrivals: SimpleQueue[CameraEvent]) -> None:
        """Start to put arrivals into the queue `arrivals`."""
        self._sender.start(arrivals)

    def trigger(self, row: int, time_s: float) -> None:
        """Deliver the frame of a row into the next queued slot; drop the frame if no slot is queued."""
        # A dropped frame uses up an id as well: a real camera also counts frames for which there is no memory.
        frame_id = next(self._ids)
        try:
            slot = self._slots.popleft()
        except IndexError:
            self._without_slot += 1
            return
        self._delivered += 1
        self._sender.request(FillRequest(self.number, row, slot.number), frame_id, time_s)

    def set_exposure(self, wanted: CameraExposure) -> None:
        """Do nothing: the frames were rendered before."""

    def rewind(self) -> None:
        """Do nothing: there is no sequencer."""

    def queue(self, slot: Slot) -> None:
        """Queue memory for a frame that is to come."""
        self._slots.append(slot)

    def take_back(self) -> list[int]:
        """Withdraw the slots that were queued and not used; return their numbers."""
        numbers = [slot.number for slot in self._slots]
        self._slots.clear()
        return numbers

    def read_clock(self) -> ClockReading:
        """Read the camera's clock, which is the same as the controller's clock."""
        return self._clock.read_exactly()

    def health(self) -> CameraHealth:
        """Return the counts of delivered and dropped frames."""
        message = f"{self._without_slot} frames found no free slot" if self._without_slot else ""
        return CameraHealth(True, message, None, self._delivered)

    def threads(self) -> tuple[SupervisedThread, ...]:
        """Return the thread that receives the sender's replies; all cameras share it."""
        return (self._sender.thread,)

    def close(self) -> None:
        """Do nothing: the connection ends with its pipe."""


def sender_devices(playback: Playback, sender: Pipe, _: StationConfig) -> Devices:
    """Return the cameras, and a controller that repeats the run of `playback` at its rate without end."""
    clock, connection, head = DeviceClock(), SenderConnection(sender), playback.run.head
    cameras = tuple(SenderCamera(n, clock, connection) for n in range(len(head.cameras)))

    def deliver(row: int, time_s: float) -> int:
        for camera in cameras:
            camera.trigger(row, time_s)
        return len(cameras)

    times_s = head.row_times_s() / playback.rate
    rows = [
        RecordedRow(
            # Rounded to ns, as `RecordedRow` requires.
            round(float(times_s[row] - times_s[0]), 9),
            head.lights[row] if head.lights else "",
            (),
            partial(deliver, row),
        )
        for row in range(head.rows)
    ]
    runs: Iterator[list[RecordedRow]] = repeat(rows)
    return Devices(cameras, ReplayController(runs, clock, playback.pause_s, None))


def acquisition_launcher(config: StationConfig, ring: Path, playback: Playback, sender: Pipe) -> Launch:
    """Return a function that starts an acquisition process with the devices of `sender_devices`."""

    def launch() -> tuple[Process, Pipe]:
        spawn = multiprocessing.get_context("spawn")
        here, there = spawn.Pipe()
        # The sender attaches to the ring as its first message; the path is known only to the station.
        sender.send(str(ring))
        arguments = (config, str(ring), there, playback, sender)
        process = spawn.Process(target=_acquire, args=arguments, name="vaoi-acquisition", daemon=True)
        process.start()
        there.close()
        return process, here

    return launch


def _acquire(config: StationConfig, ring: str, connection: Pipe, playback: Playback, sender: Pipe) -> None:
    set_up_process(one_thread=False)
    run_acquisition(config, Path(ring), connection, partial(sender_devices, playback, sender))
