"""The trigger rule as pure logic: debounce, delay, periodic pulses, tail, end of the run.

It specifies the behaviour of the firmware; `tests/hw/test_logic.py` compares the two. Times are seconds of the
controller's clock. Pulse j of a run is due at edge + delay + j · period, always computed from the edge, so that
rounding errors do not add up. An edge counts once the level has lasted `debounce_s`; the run starts at the edge. A
pulse is fired if it is due no later than the end of the tail. An interruption within the tail (a cut-out of the board,
or another board that follows too closely) continues the same run. Every confirmed edge is an event.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count

from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierBlockedAgain,
    BarrierBounce,
    BarrierClear,
    BarrierClearAfterRun,
    ControllerEvent,
    PulseFired,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.errors import InputError
from vaoi_station.model.light_program import row_of


@dataclass
class _Passage:
    """The data of a run under way."""

    first_s: float
    """Time at which pulse 0 is due."""
    fired: int = 0
    clear_s: float | None = None
    """Time at which the board left the barrier; None while it interrupts the barrier."""


class TriggerRule:
    """The state machine from one arming to the next. It takes edges and the time, and returns events in their order."""

    def __init__(self, plan: TriggerPlan, numbers: count[int]) -> None:
        """Begin with a clear barrier. `numbers` gives the numbers of events, which continue over several armings."""
        check_plan(plan)
        self.plan = plan
        self._numbers = numbers
        self._raw = False
        self._blocked = False
        self._pending_s: float | None = None
        """Time at which the raw level last changed; None once that change is confirmed."""
        self._passage: _Passage | None = None
        self._bounces: list[tuple[float, float]] = []

    @property
    def run_active(self) -> bool:
        """Whether a run is under way."""
        return self._passage is not None

    def add_edge(self, time_s: float, blocked: bool) -> None:
        """Process a change of the barrier's level. The caller must call `advance(time_s)` first."""
        if blocked == self._raw:
            return
        self._raw = blocked
        if self._pending_s is None:
            self._pending_s = time_s
        else:
            # The level returned before it was confirmed. The bounce is reported by the next `advance`, so that
            # events keep their order of time and number.
            self._bounces.append((self._pending_s, time_s - self._pending_s))
            self._pending_s = None

    def due_s(self) -> float | None:
        """Return the time at which `advance` has something to do if no edge comes earlier; None if nothing is due."""
        if self._bounces:
            return self._bounces[0][0]
        return min((t for t in (self._confirm_s(), self._pulse_s()) if t is not None), default=None)

    def advance(self, now_s: float) -> list[ControllerEvent]:
        """Return all events that are due by `now_s`."""
        events: list[ControllerEvent] = [BarrierBounce(next(self._numbers), *bounce) for bounce in self._bounces]
        self._bounces.clear()
        while True:
            confirm_s, pulse_s = self._confirm_s(), self._pulse_s()
            # At equal times, the edge is confirmed first: it may end the run and so cancel the pulse. The firmware
            # decides in the same order.
            if confirm_s is not None and confirm_s <= now_s and (pulse_s is None or confirm_s <= pulse_s):
                events += self._confirm()
            elif pulse_s is not None and pulse_s <= now_s:
                events += self._fire(pulse_s)
            else:
                return events

    def stop(self, now_s: float) -> list[ControllerEvent]:
        """End the run under way, because the controller is disarmed."""
        if self._passage is None:
            return []
        return self._end(now_s, "disarmed")

    def _confirm_s(self) -> float | None:
        return None if self._pending_s is None else self._pending_s + self.plan.debounce_s

    def _pulse_s(self) -> float | None:
        if self._passage is None:
            return None
        return self._passage.first_s + self._passage.fired * self.plan.period_s

    def _confirm(self) -> list[ControllerEvent]:
        """Accept the new level of the barrier, which has now lasted for the debounce time."""
        assert self._pending_s is not None
        edge_s, self._pending_s, self._blocked = self._pending_s, None, self._raw
        if self._blocked:
            if self._passage is not None:
                # A cut-out of the same board, or another one: cancel the tail.
                self._passage.clear_s = None
                return [BarrierBlockedAgain(next(self._numbers), edge_s)]
            self._passage = _Passage(edge_s + self.plan.start_delay_s)
            return [BarrierBlocked(next(self._numbers), edge_s)]
        if self._passage is None:
            return [BarrierClearAfterRun(next(self._numbers), edge_s)]
        self._passage.clear_s = edge_s
        # The debounce time has passed since the edge. The run cannot end before the edge is confirmed.
        return [BarrierClear(next(self._numbers), edge_s), *self._end_if_over(edge_s + self.plan.debounce_s)]

    def _fire(self, time_s: float) -> list[ControllerEvent]:
        assert self._passage is not None
        index, lights = self._passage.fired, self.plan.lights
        light = lights[index % len(lights)] if lights else ""
        row = row_of(self.plan.program, index)
        taken = () if row is None else (row.lit_us, row.gains, row.on_us)
        self._passage.fired += 1
        return [PulseFired(next(self._numbers), time_s, index, light, *taken), *self._end_if_over(time_s)]

    def _end_if_over(self, now_s: float) -> list[ControllerEvent]:
        assert self._passage is not None
        next_s, clear_s = self._pulse_s(), self._passage.clear_s
        assert next_s is not None
        # This is checked first, because a board that needed exactly `max_rows` rows has left.
        if clear_s is not None and next_s > clear_s + self.plan.tail_s:
            return self._end(now_s, "clear")
        return self._end(now_s, "max-rows") if self._passage.fired >= self.plan.max_rows else []

    def _end(self, now_s: float, reason: str) -> list[ControllerEvent]:
        assert self._passage is not None
        pulses, self._passage = self._passage.fired, None
        return [RunEnded(next(self._numbers), now_s, pulses, reason)]


def check_plan(plan: TriggerPlan) -> None:
    """Raise InputError for a plan that no controller can carry out, such as a period of 0."""
    if plan.period_s <= 0:
        raise InputError.field("trigger plan", "period_s", plan.period_s, "above 0")
    if plan.max_rows < 1:
        raise InputError.field("trigger plan", "max_rows", plan.max_rows, "at least 1")
    for key in ("start_delay_s", "tail_s"):
        # An edge is confirmed only after the debounce time. A shorter delay or tail would have passed before that.
        if not getattr(plan, key) >= plan.debounce_s >= 0:
            limit = f"no shorter than debounce_s, {plan.debounce_s} s"
            raise InputError.field("trigger plan", key, getattr(plan, key), limit, "An edge is confirmed only then.")
