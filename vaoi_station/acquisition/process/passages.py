"""The passages of boards through the barrier, by the edges that the controller reports."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import inf

from vaoi_station.acquisition.clocks import ClockModel
from vaoi_station.acquisition.controller.interface import (
    SLOWEST,
    BarrierBlocked,
    BarrierBlockedAgain,
    BarrierBounce,
    BarrierClear,
    BarrierClearAfterRun,
    BoardTooSoon,
    ControllerEvent,
    PulseFired,
    PulseSkipped,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.pairing.run_record import Interruption
from vaoi_station.acquisition.process.messages import BoardMissed

BACKWARDS_COUNTS = 20
"""Counts backwards between two edges from which on an encoder is not trusted: a belt at rest may shake by a few."""
_WRAP = 1 << 32


class BarrierLog:
    """Collects the edges of the barrier during one passage: of a run, and of what stays in the barrier after its end.

    Times are those of the controller's clock, s.
    """

    def __init__(self) -> None:
        self.interruptions: list[Interruption] = []
        self._counts: list[tuple[int | None, int | None]] = []
        """Positions of the encoder at the edges of each interruption, as far as they are known."""
        self.over = False
        """Whether the run of this passage has ended; the next interruption belongs to another passage."""

    def blocked(self, time_s: float, counts: int | None = None) -> None:
        """Add the beginning of an interruption of the barrier, at a position of the encoder."""
        if self.over:
            self.interruptions, self._counts, self.over = [], [], False
        self.interruptions.append((time_s, None))
        self._counts.append((counts, None))

    @property
    def is_open(self) -> bool:
        """Whether the barrier was still interrupted at the last edge of this passage."""
        return bool(self.interruptions) and self.interruptions[-1][1] is None

    def clear(self, time_s: float, counts: int | None = None) -> None:
        """Add the end of an interruption of the barrier, at a position of the encoder."""
        # If the report of a beginning was lost, the previous interruption is taken to have lasted until now: an
        # interruption that is too long is noticed, one that is missing is not.
        if self.interruptions:
            self.interruptions[-1] = (self.interruptions[-1][0], time_s)
            self._counts[-1] = (self._counts[-1][0], counts)

    def ways_mm(self, counts_per_mm: float) -> tuple[Interruption, ...] | None:
        """Return the way of the belt at each edge since the first one, mm, by the encoder; None if it is not known.

        It is not known either if the encoder did not count forwards while something passed: it is not connected then.
        """
        if not self._counts or (zero := self._counts[0][0]) is None:
            return None
        ways: list[tuple[int, int | None]] = []
        for (blocked, clear), (_, clear_s) in zip(self._counts, self.interruptions, strict=True):
            if blocked is None or (clear is None and clear_s is not None):
                return None
            ways.append((_way(zero, blocked), None if clear is None else _way(zero, clear)))
        edges = [way for pair in ways for way in pair if way is not None]
        if edges[-1] <= 0 or any(after - before <= -BACKWARDS_COUNTS for before, after in pairwise(edges)):
            return None
        return tuple((b / counts_per_mm, None if c is None else c / counts_per_mm) for b, c in ways)


def _way(zero: int, counts: int) -> int:
    """Return the counts from one position to another, of a counter of 32 bits."""
    return (counts - zero + _WRAP // 2) % _WRAP - _WRAP // 2


def since_first(interruptions: Sequence[Interruption]) -> tuple[Interruption, ...]:
    """Return interruptions relative to the beginning of the first one, in s."""
    zero_s = interruptions[0][0] if interruptions else 0.0
    return tuple((b - zero_s, None if c is None else c - zero_s) for b, c in interruptions)


class PassageLog:
    """Collects the confirmed edges of the barrier, passage by passage."""

    def __init__(self, clock: ClockModel) -> None:
        """Begin without a passage."""
        self._clock = clock
        self.barrier = BarrierLog()
        """The interruptions of the latest passage."""
        self.edge_s = 0.0
        """Host time of the latest edge that begins a passage, or of the latest request of a single pulse."""
        self._edge_taken = True
        """Whether a run has begun since that edge."""

    @property
    def edge_known(self) -> bool:
        """Whether `edge_s` is the edge of the run that begins next; if not, the report of its edge was lost."""
        # A passage may end without a pulse: its edge is not that of the next board.
        return not self._edge_taken and not self.barrier.over

    def forget(self) -> None:
        """Begin without a passage: what is in the barrier is not known."""
        self.barrier, self._edge_taken = BarrierLog(), True

    def begin_single(self, now_s: float) -> None:
        """Begin the passage of a single pulse, which no edge begins."""
        self.forget()
        self.edge_s, self._edge_taken = now_s, False

    def begin_run(self) -> BarrierLog:
        """Return the interruptions of the run that begins. There are none if the report of its edge was lost."""
        if self.barrier.over:
            self.forget()
        self._edge_taken = True
        return self.barrier

    def add(self, event: ControllerEvent, now_s: float) -> BoardMissed | None:
        """Add an edge to its passage. Return a report if it shows that a board passed without a run."""
        if isinstance(event, BarrierBlocked):
            self.forget()
            self.edge_s, self._edge_taken = self._host_s(event, now_s), False
            self.barrier.blocked(event.time_s, event.counts)
        elif isinstance(event, BarrierBlockedAgain):
            self.barrier.blocked(event.time_s, event.counts)
        elif isinstance(event, BarrierClear):
            self.barrier.clear(event.time_s, event.counts)
        elif isinstance(event, BarrierClearAfterRun):
            # What stays in the barrier after its run belongs to that run. Anything else was in the barrier before its
            # edge counted.
            if not self.barrier.is_open:
                return BoardMissed(self._host_s(event, now_s), "it stood in the barrier when the line was armed")
            self.barrier.clear(event.time_s, event.counts)
        elif isinstance(event, BoardTooSoon):
            self.forget()
            self.barrier.blocked(event.time_s)
            reason = f"it came {event.gap_s:.3f} s after the one before had left"
            return BoardMissed(self._host_s(event, now_s), reason)
        return None

    def _host_s(self, event: ControllerEvent, now_s: float) -> float:
        return min(self._clock.host_s(event.time_s), now_s)


STILL_S = 5.0
"""Shortest time without a row after which a belt that spaces the rows counts as stopped."""
UNREPORTED_S = 1.0
"""Time, s, in addition to the debounce, after which an interrupted barrier without a report of its edge belongs to a
board whose edge will not be reported."""


class PassageWatch:
    """Follows the events of the armed controller. Unlike the session, also those of a run that was given up."""

    def __init__(self) -> None:
        """Begin disarmed, with a clear barrier."""
        self._plan: TriggerPlan | None = None
        self._row_s: float | None = None
        """Host time of the run's latest row, or of its latest interruption of the barrier; None without a run."""
        self._blocked = False
        self._standing = False
        self._unreported_s: float | None = None
        """Host time since which the barrier has been interrupted without a report; None if it is not."""

    @property
    def standing(self) -> bool:
        """Whether a board is in the barrier that is not filmed, because it came while the line was not armed."""
        return self._standing

    @property
    def passing(self) -> bool:
        """Whether a run is under way at the controller, or a board is in the barrier after its run."""
        return self._row_s is not None or self._blocked

    def belt_stopped(self, now_s: float) -> bool:
        """Return whether no row was due for so long that the belt, which spaces the rows, must have stopped."""
        if self._plan is None or self._plan.belt is None or self._row_s is None:
            return False
        slow_s = SLOWEST * max(self._plan.start_delay_s, self._plan.period_s)
        return now_s - self._row_s > max(STILL_S, slow_s)

    def arm(self, plan: TriggerPlan, blocked: bool | None) -> None:
        """Follow events from now on. The events of an arming before this one end with those of its run."""
        self._plan = plan
        self._standing = bool(blocked) and not self.passing

    def disarm(self) -> None:
        """Ignore events until the controller is armed again."""
        self._plan, self._row_s, self._blocked = None, None, False
        self._standing, self._unreported_s = False, None

    def check_level(self, blocked: bool | None, now_s: float) -> None:
        """Compare the level of the barrier, at most a heartbeat old, with what was reported; reports may be lost."""
        if self._plan is None or self._row_s is not None or blocked is None:
            self._unreported_s = None
        elif not blocked:
            self._blocked, self._standing, self._unreported_s = False, False, None
        elif not self.passing:
            # A level is often known sooner than the edge is reported, which waits for the debounce.
            self._unreported_s = now_s if self._unreported_s is None else self._unreported_s
            self._standing |= now_s - self._unreported_s > UNREPORTED_S + self._plan.debounce_s

    def forget_barrier(self) -> None:
        """Take the barrier as clear outside a run, because the report that it became clear may be lost."""
        self._blocked = self._blocked and self._row_s is not None

    def add(self, event: ControllerEvent, now_s: float) -> bool:
        """Evaluate an event; return whether it changed `passing` or `standing`."""
        before = self.passing, self.standing
        if self._plan is None:
            return False
        if not isinstance(event, RunEnded | BarrierBounce):
            self._standing, self._unreported_s = False, None
        if isinstance(event, BarrierBlocked | BarrierBlockedAgain):
            self._row_s, self._blocked = now_s, True
        elif isinstance(event, PulseFired | PulseSkipped):
            self._row_s = now_s
        elif isinstance(event, BoardTooSoon):
            self._blocked = True
        elif isinstance(event, BarrierClear | BarrierClearAfterRun):
            self._blocked = False
        elif isinstance(event, RunEnded):
            # Any other end may leave the board in the barrier. A replay never reports that its barrier is clear.
            self._row_s, self._blocked = None, self._blocked and event.reason != "clear"
        return (self.passing, self.standing) != before


class OutdatedEvents:
    """Recognises late events, so that they begin no run and are no missed board. Used by the session only."""

    def __init__(self, controller_clock: ClockModel) -> None:
        """Begin without anything that was given up."""
        self._clock = controller_clock
        self._until_s = -inf
        """Host time before which events are outdated."""

    def give_up(self) -> None:
        """Ignore events from now on, until the end of a run is reported, or the next board."""
        self._until_s = inf

    def expect_pulse(self, earliest_s: float) -> None:
        """Use the events of a pulse that was fired, from a host time on; those before it stay outdated."""
        self._until_s = min(self._until_s, earliest_s)

    def forget(self) -> None:
        """Use all events again: the controller is disarmed, and its events are handled."""
        self._until_s = -inf

    def has(self, event: ControllerEvent) -> bool:
        """Return whether an event is outdated. The end of a run, the next board or a later event resets this."""
        if self._until_s == -inf:
            return False
        late = not isinstance(event, BarrierBlocked) and self._clock.host_s(event.time_s) < self._until_s
        if not late or isinstance(event, RunEnded):
            self.forget()
        return late
