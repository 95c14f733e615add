"""A controller that replays recordings. It fires at the recorded times, or when the last row was processed.

Device times are the recording's trigger times shifted by a whole number of ns per run. A replayed run
therefore has exactly the result of its recording when it is stitched from its files.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import Protocol

from vaoi_station.acquisition.cameras.interface import DeviceFault
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    ControllerEvent,
    ControllerLimits,
    EventQueue,
    LineOutput,
    Permit,
    PulseFired,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.device_clock import DeviceClock
from vaoi_station.errors import InputError, StateError, VaoiError
from vaoi_station.supervised_thread import DEVICE_LIMIT_S, SupervisedThread

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


class Pace(Protocol):
    """The pace of a replay that does not follow the clock.

    Its methods wait; they return early once `stop()` is true.
    """

    def before_run(self, stop: Callable[[], bool]) -> None:
        """Wait until a run may begin."""

    def before_pulse(self, stop: Callable[[], bool]) -> None:
        """Wait until the pulse of the next row may be fired."""

    def frames_coming(self, frames: int) -> None:
        """Record that `frames` more frames will be delivered with the next pulse."""

    def wake(self) -> None:
        """Wake all waiting methods, so that they evaluate `stop` again."""


class ReplayController:
    """A `Controller` that plays recorded runs while it is armed. Each run is a list of rows."""

    def __init__(
        self, runs: Iterator[list[RecordedRow]], clock: DeviceClock, pause_s: float, pace: Pace | None
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

    def permit_board(self, permit: Permit | None) -> None:
        """Ignore the permit: the boards of a replay have come already."""

    def line_output(self) -> LineOutput | None:
        """Return None: a replay has no outputs."""
        return None

    def limits(self) -> ControllerLimits:
        """Return no limits: a replay plays what the recording holds, and takes no other program."""
        return ControllerLimits()

    def barrier_blocked(self) -> None:
        """Return None: the boards of a replay have come already."""

    def is_watching(self) -> bool:
        """Return True: this controller is part of the process."""
        return True

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
            if run is None or not self._wait_armed():
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
                self._pace.before_run(stop)
        # A paced replay runs faster than its clock, so the previous run may end in the future of this clock. The next
        # run begins after that, because device times must not overlap.
        barrier_s = max(self._clock.now_s() + LEAD_S, self._last_end_s + GAP_S if self._pace else 0.0)
        # Whole nanoseconds are used, so that sums with the rounded recorded times are the same in every run.
        first_s = round(barrier_s + LEAD_S, 9)
        if not self._wait_until(barrier_s, stop) or not self._begin_run(barrier_s, stop):
            return
        for index, row in enumerate(run):
            device_s = first_s + row.time_s
            if not self._wait_until(device_s, stop) or not self._fire(index, row, device_s, stop):
                return
        with self._change:
            if not stop():
                # There is no BarrierClear: a recording does not state when its board left the barrier.
                self._end_run(first_s + run[-1].time_s, "clear")

    def _begin_run(self, barrier_s: float, stop: Callable[[], bool]) -> bool:
        with self._change:
            if stop():
                return False
            self._in_run, self._pulses = True, 0
            self._put(BarrierBlocked(next(self._numbers), barrier_s))
            return True

    def _fire(self, index: int, row: RecordedRow, device_s: float, stop: Callable[[], bool]) -> bool:
        with self._change:
            if stop():
                return False
            self._pulses += 1
            self._last_end_s = device_s
            # The pulse is reported before its frames, so that the recorder can assign them at once.
            self._put(PulseFired(next(self._numbers), device_s, index, row.light, row.exposures_us, row.gains))
            frames = row.deliver(device_s)
            if self._pace is not None:
                self._pace.frames_coming(frames)
            return True

    def _end_run(self, time_s: float, reason: str) -> None:
        self._in_run = False
        self._put(RunEnded(next(self._numbers), time_s, self._pulses, reason))

    def _put(self, event: ControllerEvent) -> None:
        self._events.put(event)

    def _wait_until(self, device_s: float, stop: Callable[[], bool]) -> bool:
        """Wait until a device time, or until the pace permits the next pulse. Return False if `stop()` becomes true."""
        if self._pace is not None:
            with self._thread.waiting():
                self._pace.before_pulse(stop)
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

    def _wait_armed(self) -> bool:
        with self._change, self._thread.waiting():
            self._change.wait_for(lambda: self._closing or self._plan is not None)
            return not self._closing
