"""The trigger rule as pure logic: debounce, delay, periodic pulses, tail, end of the run.

It specifies the behaviour of the firmware; `tests/hw/test_logic.py` compares the two. Times are seconds of the
controller's clock. Pulse j of a run is due at edge + delay + j · period, always computed from the edge, so that
rounding errors do not add up. An edge counts once the level has lasted `debounce_s`; the run starts at the edge. A
pulse is fired if it is due no later than the end of the tail. An interruption within the tail (a cut-out of the board,
or another board that follows too closely) continues the same run. Every confirmed edge is an event.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import count
from typing import Protocol

from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierBlockedAgain,
    BarrierBounce,
    BarrierClear,
    BarrierClearAfterRun,
    ControllerEvent,
    PulseFired,
    PulseSkipped,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.errors import InputError
from vaoi_station.line_config import ENCODER_LATENCY_S
from vaoi_station.model.recording import row_of

TOO_FAST = "the controller did not fire it: the board was faster than the cameras can follow"
"""Why a row was skipped that the encoder asked for too soon."""
_SAME_S = 1e-7


class BeltCounter(Protocol):
    """The counts of the encoder over the time. Simulated controllers count; the firmware has an encoder."""

    def counts_at(self, time_s: float) -> int:
        """Return the counts up to a time."""

    def time_of(self, counts: int) -> float:
        """Return the time at which a count is reached; infinite if the belt stops before."""


@dataclass
class _Passage:
    first_s: float
    fired: int = 0
    clear_s: float | None = None
    place: int = 0
    """Count of the encoder at which the next row is due."""
    confirmed_s: float = 0.0
    """Time at which the beginning of the run was decided; no row is due before."""
    pulse_s: float = -math.inf


class TriggerRule:
    """The state machine from one arming to the next. It takes edges and the time, and returns events in their order."""

    def __init__(self, plan: TriggerPlan, numbers: count[int], belt: BeltCounter | None = None) -> None:
        check_plan(plan)
        self.plan = plan
        self._belt = belt if plan.belt is not None else None
        self._numbers = numbers
        self._raw = False
        self._blocked = False
        self._pending_s: float | None = None
        """Time at which the raw level last changed; None once that change is confirmed."""
        self._passage: _Passage | None = None
        self._bounces: list[tuple[float, float]] = []

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
        if self._belt is None:
            return self._passage.first_s + self._passage.fired * self.plan.period_s
        reached_s = max(self._belt.time_of(self._passage.place), self._passage.confirmed_s)
        return None if math.isinf(reached_s) else reached_s + ENCODER_LATENCY_S

    def _confirm(self) -> list[ControllerEvent]:
        assert self._pending_s is not None
        edge_s, self._pending_s, self._blocked = self._pending_s, None, self._raw
        counts = None if self._belt is None else self._belt.counts_at(edge_s)
        if self._blocked:
            if self._passage is not None:
                # A cut-out of the same board, or another one: cancel the tail.
                self._passage.clear_s = None
                return [BarrierBlockedAgain(next(self._numbers), edge_s, counts)]
            self._passage = _Passage(edge_s + self.plan.start_delay_s, confirmed_s=edge_s + self.plan.debounce_s)
            if counts is not None and self.plan.belt is not None:
                self._passage.place = counts + self.plan.belt.start
            return [BarrierBlocked(next(self._numbers), edge_s, counts)]
        if self._passage is None:
            return [BarrierClearAfterRun(next(self._numbers), edge_s, counts)]
        self._passage.clear_s = edge_s
        # The debounce time has passed since the edge. The run cannot end before the edge is confirmed.
        return [BarrierClear(next(self._numbers), edge_s, counts), *self._end_if_over(edge_s + self.plan.debounce_s)]

    def _fire(self, time_s: float) -> list[ControllerEvent]:
        assert self._passage is not None
        index, lights = self._passage.fired, self.plan.lights
        light = lights[index % len(lights)] if lights else ""
        row = row_of(self.plan.program, index)
        taken = () if row is None else (row.lit_us, row.gains, row.on_us)
        self._passage.fired += 1
        if self.plan.belt is not None:
            self._passage.place += self.plan.belt.row
            if time_s - self._passage.pulse_s < self.plan.belt.shortest_s - _SAME_S:
                skipped = PulseSkipped(next(self._numbers), time_s, index, TOO_FAST)
                return [skipped, *self._end_if_over(time_s)]
        self._passage.pulse_s = time_s
        return [PulseFired(next(self._numbers), time_s, index, light, *taken), *self._end_if_over(time_s)]

    def _end_if_over(self, now_s: float) -> list[ControllerEvent]:
        assert self._passage is not None
        # This is checked first, because a board that needed exactly `max_rows` rows has left.
        if self._passage.clear_s is not None and self._is_beyond_tail(self._passage, self._passage.clear_s):
            return self._end(now_s, "clear")
        return self._end(now_s, "max-rows") if self._passage.fired >= self.plan.max_rows else []

    def _is_beyond_tail(self, passage: _Passage, clear_s: float) -> bool:
        if self._belt is not None and self.plan.belt is not None:
            return passage.place > self._belt.counts_at(clear_s) + self.plan.belt.tail
        return passage.first_s + passage.fired * self.plan.period_s > clear_s + self.plan.tail_s

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
