"""A controller that applies the firmware's trigger rule in real time, with a simulated clock, in a thread."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from itertools import count
from typing import Protocol

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
from vaoi_station.acquisition.controller.trigger_rule import TriggerRule
from vaoi_station.acquisition.device_clock import DeviceClock
from vaoi_station.errors import StateError
from vaoi_station.supervised_thread import DEVICE_LIMIT_S, SupervisedThread

Edge = tuple[float, bool]
"""Time by the controller's clock, and whether the barrier is interrupted from then on."""


class DrivenLine(Protocol):
    """The methods of the simulated line that a simulated controller calls."""

    def accept(self, plan: TriggerPlan) -> TriggerPlan:
        """Return the plan with the line's lights filled in. Raise InputError if the line cannot follow the plan."""

    def lights(self) -> tuple[str, ...]:
        """Return the names of the lights that the line has."""

    def counts_at(self, time_s: float) -> int:
        """Return the counts of the belt's encoder up to a time of the controller's clock."""

    def time_of(self, counts: int) -> float:
        """Return the controller's time at which the encoder reaches a count; infinite if it does not."""

    def fire(self, event: PulseFired) -> None:
        """Expose all cameras for a pulse of a board."""

    def fire_single(self, event: PulseFired) -> None:
        """Expose all cameras for a single pulse that `fire_one` has requested."""

    def set_armed(self, armed: bool) -> None:
        """Let boards enter the belt if `armed`; otherwise hold them back."""

    def end_run(self) -> None:
        """Record that a run has ended."""

    def permit_board(self, permit: Permit | None) -> None:
        """Let one board come while the permit is valid, if the conveyor obeys the interlock."""

    def line_output(self) -> LineOutput | None:
        """Return whether a board may come now; None if the conveyor does not obey the interlock."""


class SimulatedController:
    """A `Controller` that follows a `TriggerRule` and calls the simulated line instead of setting pins."""

    def __init__(self, clock: DeviceClock, line: DrivenLine) -> None:
        """Create a controller for a simulated line. `clock` is the controller's simulated clock."""
        self.clock = clock
        self._line = line
        self._numbers = count()
        self._changed = threading.Condition()
        self._edges: deque[Edge] = deque()
        self._rule: TriggerRule | None = None
        self._closing = False
        self._runs = 0
        self._thread = SupervisedThread(self._work, "controller", DEVICE_LIMIT_S)

    def start(self, events: EventQueue) -> None:
        """Begin to put events into the queue `events`."""
        self._events = events
        self._thread.start()

    def arm(self, plan: TriggerPlan) -> None:
        """Film every board that passes the barrier from now on with this plan."""
        rule = TriggerRule(self._line.accept(plan), self._numbers, self._line)
        with self._changed:
            self._rule = rule
            # Edges of a board that entered before belong to no run of this arming.
            self._edges.clear()
            self._changed.notify()
        # Only now may boards enter: edges scheduled before the rule is in place would have been cleared.
        self._line.set_armed(True)

    def disarm(self) -> None:
        """Ignore the barrier from now on and end a run under way."""
        with self._changed:
            if self._rule is not None:
                self._report(self._rule.stop(self.clock.now_s()))
            self._rule = None
            self._edges.clear()
        self._line.set_armed(False)
        self._line.end_run()

    def fire_one(self, light: str = "", on_us: float | None = None) -> None:
        """Fire one pulse now."""
        with self._changed:
            if self._rule is not None:
                raise StateError("the controller is armed: its pulses belong to boards.", action="Disarm, then fire.")
            pulse = PulseFired(next(self._numbers), self.clock.now_s(), 0, light, on_us=on_us)
            self._line.fire_single(pulse)
            self._events.put(pulse)
            self._events.put(RunEnded(next(self._numbers), pulse.time_s, 1, "single"))

    def schedule_edges(self, edges: Sequence[Edge]) -> None:
        """Schedule future changes of the barrier, given in the order of their times."""
        with self._changed:
            self._edges.extend(edges)
            self._changed.notify()

    def read_clock(self) -> ClockReading:
        """Compare the controller's clock with the host's."""
        return self.clock.read()

    def permit_board(self, permit: Permit | None) -> None:
        """Permit the next board, or hold boards back."""
        self._line.permit_board(permit)

    def line_output(self) -> LineOutput | None:
        """Return whether the simulated conveyor may let a board in; None if it does not obey the interlock."""
        return self._line.line_output()

    def limits(self) -> ControllerLimits:
        """Return the lights of the simulated line; it has no other limits."""
        return ControllerLimits(lights=self._line.lights())

    def barrier_blocked(self) -> None:
        """Return None: boards come only while the line is armed."""

    def is_watching(self) -> bool:
        """Return True: this controller is part of the process."""
        return True

    def health(self) -> str:
        """Return a sentence with the state and the number of boards so far."""
        return f"simulated: {'armed' if self._rule else 'idle'}, {self._runs} boards seen"

    def threads(self) -> tuple[SupervisedThread, ...]:
        """Return the thread that simulates the controller."""
        return (self._thread,)

    def close(self) -> None:
        """End the thread that simulates the controller, and wait for its end."""
        self._thread.expect_end()
        with self._changed:
            self._closing, self._rule = True, None
            self._changed.notify()
        if self._thread.ident is not None:
            self._thread.join()

    def _work(self) -> None:
        with self._changed:
            while not self._closing:
                # The lock is held during the whole step, so that `disarm` never interrupts the report of a run.
                ended = self._step(self.clock.now_s())
                if ended:
                    self._line.end_run()
                with self._thread.waiting():
                    self._changed.wait(self._wait_s())

    def _step(self, now_s: float) -> bool:
        """Do everything that is due at the time `now_s`. Return whether a run has ended by this."""
        if self._rule is None:
            return False
        events: list[ControllerEvent] = []
        while self._edges and self._edges[0][0] <= now_s:
            time_s, blocked = self._edges.popleft()
            # Pulses due before the edge come first, even if this thread wakes up late.
            events += self._rule.advance(time_s)
            self._rule.add_edge(time_s, blocked)
        events += self._rule.advance(now_s)
        self._report(events)
        return any(isinstance(e, RunEnded) for e in events)

    def _report(self, events: Sequence[ControllerEvent]) -> None:
        for event in events:
            if isinstance(event, PulseFired):
                # Cameras are triggered before the pulse is reported to the host, as with the real controller.
                self._line.fire(event)
            self._runs += isinstance(event, BarrierBlocked)
            self._events.put(event)

    def _wait_s(self) -> float | None:
        if self._rule is None:
            return None
        times = [t for t in (self._rule.due_s(), self._edges[0][0] if self._edges else None) if t is not None]
        return max(self.clock.host_s(min(times)) - self.clock.host_s(self.clock.now_s()), 0.0) if times else None
