"""Recordings in place of line, cameras and controller."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import count, cycle, islice

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.cameras.interface import DeviceFault
from vaoi_station.acquisition.cameras.virtual import Exposure, VirtualCamera
from vaoi_station.acquisition.clocks import ClockReading, DeviceClock
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    Controller,
    EventQueue,
    PulseFired,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.devices import Devices, Feedback
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError, StateError, VaoiError
from vaoi_station.files import Recording, open_recording
from vaoi_station.pixel_formats import PIXEL_FORMATS
from vaoi_station.supervised_thread import DEVICE_LIMIT_S, SupervisedThread


class ReplayCamera(VirtualCamera):
    """A camera that delivers recorded frames; it shares its clock with the replayed controller."""

    def __init__(self, number: int, clock: DeviceClock) -> None:
        super().__init__(number, clock.read_exactly)
        self._ids = count(1)

    def play(self, time_s: float, pixels: NDArray[np.uint8] | None) -> None:
        """Deliver a recorded frame now, with time stamp `time_s`. `pixels` is None if the recording lacks the frame."""
        # A frame that the recording lacks uses an id too, so that the gap in the ids shows a loss in transfer.
        frame_id = next(self._ids)
        if pixels is not None:
            now_s = time.monotonic()
            self.expose(Exposure(frame_id, time_s, now_s, now_s, pixels))


LEAD_S = 0.05
"""Time from the barrier to the first pulse, and from arming to the barrier."""
GAP_S = 1.0
"""Shortest time between two runs on the device's clock."""


@dataclass(frozen=True)
class RecordedRow:
    """One pulse of a recording. `time_s` counts from the first pulse and is rounded to 1 ns."""

    time_s: float
    light: str
    exposures_us: tuple[float, ...]
    deliver: Callable[[float], int]
    """Deliver the row's frames with this device time; return the number of frames that will arrive."""
    gains: tuple[float, ...] = ()


class ReplayController(Controller):
    """A `Controller` that plays recorded runs while it is armed. Each run is a list of rows."""

    def __init__(
        self, runs: Iterator[list[RecordedRow]], clock: DeviceClock, pause_s: float, pace: Feedback | None
    ) -> None:
        """Prepare to play `runs` in order, with pauses of `pause_s`. A `pace` replaces the clock and the pauses."""
        self._runs, self._clock, self._pause_s, self._pace = runs, clock, pause_s, pace
        self._numbers = count()
        self._change = threading.Condition()
        self._plan: TriggerPlan | None = None
        self._episode = 0
        """Number of the present arming; a run stops when this number changes."""
        self._in_run = self._closing = False
        self._pulses = 0
        self._played = 0
        self._last_end_s = 0.0
        self._thread = SupervisedThread(self._play_all, "controller", DEVICE_LIMIT_S)

    def start(self, events: EventQueue) -> None:
        """Begin to put events into the queue `events`."""
        self._events = events
        self._thread.start()

    def arm(self, plan: TriggerPlan) -> None:
        """Replay recordings from now on: put their barrier changes and pulses into the queue of events."""
        with self._change:
            self._plan, self._episode = plan, self._episode + 1
            self._change.notify_all()

    def disarm(self) -> None:
        """End a run under way, and skip the rest of its recording."""
        with self._change:
            self._plan = None
            if self._in_run:
                self._end_run(self._clock.now_s(), "disarmed")
            self._wake()

    def fire_one(self, light: str = "", on_us: float | None = None) -> None:  # noqa: ARG002
        """Raise StateError: a recording has no frames except those of its pulses."""
        raise StateError(
            "a replay plays recorded boards; it cannot fire a pulse of its own.",
            action="Film the boards it plays: vaoi record without --still.",
        )

    def read_clock(self) -> ClockReading:
        """Compare the clock of the replay with the host's; the reading is exact."""
        return self._clock.read_exactly()

    def health(self) -> str:
        """Return a sentence with the number of runs that were played."""
        return f"replay: {self._played} runs played"

    def threads(self) -> tuple[SupervisedThread, ...]:
        """Return the thread that replays recordings."""
        return (self._thread,)

    def close(self) -> None:
        """End the thread that replays recordings, and wait for its end."""
        self._thread.expect_end()
        with self._change:
            self._plan, self._closing = None, True
            self._wake()
        if self._thread.ident is not None:
            self._thread.join()

    def _play_all(self) -> None:
        while True:
            try:
                run = next(self._runs, None)
            # A recording that cannot be read is reported like a device that fails; the station stays up.
            except VaoiError as error:
                self._events.put(DeviceFault("replay", error))
                run = None
            with self._change, self._thread.waiting():
                if run is not None:
                    self._change.wait_for(lambda: self._closing or self._plan is not None)
            if run is None or self._closing:
                self._thread.expect_end()  # there is nothing more to play
                return
            self._play(run)
            self._played += 1
            if self._pace is None:
                self._wait_until_host(time.monotonic() + self._pause_s, lambda: self._closing)

    def _play(self, run: list[RecordedRow]) -> None:
        with self._change:
            episode, plan = self._episode, self._plan
        if plan is None:
            return

        def stop() -> bool:
            return self._closing or self._plan is None or self._episode != episode

        if len(run) > plan.max_rows:
            limit = f"at least the {len(run)} rows of the recording"
            self._events.put(DeviceFault("replay", InputError.field("trigger plan", "max_rows", plan.max_rows, limit)))
            return
        if self._pace is not None:
            with self._thread.waiting():
                self._pace.wait_for_memory(stop)
        # A paced replay runs faster than its clock, so the previous run may end in the future of this clock. The next
        # run begins after that, because device times must not overlap.
        barrier_s = max(self._clock.now_s() + LEAD_S, self._last_end_s + GAP_S if self._pace else 0.0)
        # Whole nanoseconds are used, so that sums with the rounded recorded times are the same in every run.
        first_s = round(barrier_s + LEAD_S, 9)
        if not self._wait_until(barrier_s, stop):
            return
        with self._change:
            if stop():
                return
            self._in_run, self._pulses = True, 0
            self._events.put(BarrierBlocked(next(self._numbers), barrier_s))
        for index, row in enumerate(run):
            device_s = first_s + row.time_s
            if not self._wait_until(device_s, stop):
                return
            with self._change:
                if stop():
                    return
                self._pulses += 1
                self._last_end_s = device_s
                # The pulse is reported before its frames, so that the recorder can assign them at once.
                pulse = PulseFired(next(self._numbers), device_s, index, row.light, row.exposures_us, row.gains)
                self._events.put(pulse)
                frames = row.deliver(device_s)
                if self._pace is not None:
                    self._pace.expect_frames(frames)
        with self._change:
            if not stop():
                # There is no BarrierClear: a recording does not state when its board left the barrier.
                self._end_run(first_s + run[-1].time_s, "clear")

    def _end_run(self, time_s: float, reason: str) -> None:
        self._in_run = False
        self._events.put(RunEnded(next(self._numbers), time_s, self._pulses, reason))

    def _wait_until(self, device_s: float, stop: Callable[[], bool]) -> bool:
        """Wait until a device time, or until the pace permits the next pulse. Return False if `stop()` becomes true."""
        if self._pace is not None:
            with self._thread.waiting():
                self._pace.wait_for_frames(stop)
            return not stop()
        return self._wait_until_host(self._clock.host_s(device_s), stop)

    def _wait_until_host(self, host_s: float, stop: Callable[[], bool]) -> bool:
        with self._change:
            while not stop() and (left_s := host_s - time.monotonic()) > 0:
                with self._thread.waiting():
                    self._change.wait(left_s)
            return not stop()

    def _wake(self) -> None:
        self._change.notify_all()
        if self._pace is not None:
            self._pace.wake()


CACHED_RECORDINGS = 4
Pixels = dict[tuple[int, int], NDArray[np.uint8]]


def open_replay(config: StationConfig) -> Devices:
    """Open cameras and controller that play `config.replay`."""
    assert config.replay is not None
    recordings = [open_recording(path) for path in config.replay.recordings]
    for recording in recordings:
        _check(recording, config)
    clock, feedback = DeviceClock(), Feedback()
    cameras = tuple(ReplayCamera(n, clock) for n in range(len(config.cameras)))
    formats = tuple(camera.pixel_format for camera in config.cameras)
    decode = lru_cache(maxsize=CACHED_RECORDINGS)(partial(_decode, formats=formats))
    # Decoded before the line is armed: the first run must not wait for the disk.
    decode(recordings[0])
    order = cycle(recordings)
    runs = (_rows(r, cameras, decode(r)) for r in (islice(order, config.replay.runs) if config.replay.runs else order))
    pace = feedback if config.replay.pace == "fast" else None
    return Devices(cameras, ReplayController(runs, clock, config.replay.pause_s, pace), feedback)


def _rows(recording: Recording, cameras: tuple[ReplayCamera, ...], pixels: Pixels) -> list[RecordedRow]:
    head = recording.head
    times = head.row_times_s()

    def show(row: int, device_s: float) -> int:
        for n, camera in enumerate(cameras):
            camera.play(device_s, pixels.get((n, row)))
        return sum((n, row) in pixels for n in range(len(cameras)))

    return [
        RecordedRow(
            round(float(times[row] - times[0]), 9),
            head.lights[row] if head.lights else "",
            head.exposures_us[row] if head.exposures_us else (),
            partial(show, row),
            head.gains[row] if head.gains else (),
        )
        for row in range(head.rows)
    ]


def _decode(recording: Recording, formats: tuple[str, ...]) -> Pixels:
    """Return all frames of a recording as flat bytes, in the form in which cameras of these pixel formats send them."""
    frames: Pixels = {}
    for n, pixel_format in enumerate(formats):
        for row in range(recording.head.rows):
            image = recording.frame(n, row)
            if image is None:
                continue
            if image.ndim != 2 or image.dtype != PIXEL_FORMATS[pixel_format].dtype:
                shown = f"{image.dtype.itemsize * 8} bit {'grey' if image.ndim == 2 else 'colour'}"
                raise InputError(
                    f"{recording.frame_path(n, row)}: is {shown}, but camera {n} of the station is {pixel_format}.",
                    action="Set pixel_format of the camera to that of the recording.",
                )
            frames[n, row] = np.ascontiguousarray(image).reshape(-1).view(np.uint8)
    return frames


def _check(recording: Recording, config: StationConfig) -> None:
    head, where = recording.head, recording.directory / "recording.json"
    if len(head.cameras) != len(config.cameras):
        raise InputError.field(where, "cameras", len(head.cameras), f"{len(config.cameras)}, as in station.toml")
    for n, (filmed, ours) in enumerate(zip(head.cameras, config.cameras, strict=True)):
        if (filmed.width, filmed.height) != (ours.width, ours.height):
            size = f"{ours.width}×{ours.height} px, as in station.toml"
            raise InputError.field(where, f"cameras[{n}]", f"{filmed.width}×{filmed.height} px", size)
    line = config.line
    if head.rows > config.rows_per_run:
        limit = f"at most the {config.rows_per_run} slots per camera of the ring"
        raise InputError.field(where, "rows", head.rows, limit, "Raise [line] longest_board_mm or [ring] spare_rows.")
    if not math.isclose(head.trigger_period_s, line.trigger_period_s, rel_tol=1e-6):
        raise InputError.field(where, "trigger_period_s", head.trigger_period_s, f"{line.trigger_period_s} ([line])")
    if not np.allclose(head.conveyor_mm_s, line.conveyor_mm_s, rtol=1e-6, atol=1e-6):
        raise InputError.field(where, "conveyor_mm_s", head.conveyor_mm_s, f"{line.conveyor_mm_s} ([line])")
