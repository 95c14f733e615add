"""A controller without hardware that a test drives row by row, for runs of scripted cameras."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import count

from vaoi_station.acquisition.clocks import ClockReading, DeviceClock
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierClear,
    Controller,
    EventQueue,
    PulseFired,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.errors import StateError
from vaoi_station.supervised_thread import SupervisedThread


class ScriptedController(Controller):
    """A `Controller` that fires when the test says so."""

    def __init__(self) -> None:
        self._clock = DeviceClock()
        self._numbers = count()

    def start(self, events: EventQueue) -> None:
        self._events = events

    def arm(self, plan: TriggerPlan) -> None:
        """Do nothing: boards come when the test lets them."""

    def disarm(self) -> None:
        """Do nothing: no board is under way when a test disarms."""

    def fire_one(self, light: str = "", on_us: float | None = None) -> None:
        """Raise StateError: the only pulses are those of a board."""
        raise StateError("this line fires only while a board passes.")

    def read_clock(self) -> ClockReading:
        return self._clock.read()

    def health(self) -> str:
        return "scripted"

    def threads(self) -> tuple[SupervisedThread, ...]:
        return ()

    def close(self) -> None:
        """Do nothing."""

    def board(self, rows: int, expose: Callable[[int, int], object]) -> None:
        """Let a board pass: `expose(row, edge_ns)` makes the cameras expose, and paces the rows.

        `edge_ns` is the monotonic time of the pulse. Row −1 is the delay between the barrier and the first pulse.
        """
        self._events.put(BarrierBlocked(next(self._numbers), self._clock.now_s()))
        expose(-1, 0)
        for row in range(rows):
            edge_ns = time.monotonic_ns()
            expose(row, edge_ns)
            self._events.put(PulseFired(next(self._numbers), self._clock.device_s(edge_ns * 1e-9), row))
        self._events.put(BarrierClear(next(self._numbers), self._clock.now_s()))
        self._events.put(RunEnded(next(self._numbers), self._clock.now_s(), rows, "clear"))
