"""The passages of boards through the barrier, by the edges that the controller reports."""

from __future__ import annotations

from itertools import pairwise

from vaoi_station.acquisition.clocks import ClockModel
from vaoi_station.acquisition.controller.interface import (
    SLOWEST,
    BarrierBlocked,
    BarrierBlockedAgain,
    BarrierBounce,
    BarrierClear,
    BarrierClearAfterRun,
    BarrierEdge,
    BoardTooSoon,
    ContactsChanged,
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


class Passages:
    """Collects the confirmed edges of the barrier, passage by passage: those of a run, and of what stays after it."""

    def __init__(self, clock: ClockModel) -> None:
        self._clock = clock
        self.edge_s = 0.0
        """Host time of the latest edge that begins a passage, or of the latest request of a single pulse."""
        self.forget()

    def forget(self) -> None:
        """Begin without a passage: what is in the barrier is not known."""
        self.interruptions: list[Interruption] = []
        """Interruptions of the latest passage, by the controller's clock. The list grows during a passage."""
        self._counts: list[tuple[int | None, int | None]] = []
        self.over = False
        """Whether the run of this passage has ended; the next interruption belongs to another passage."""
        self._edge_taken = True
        """Whether a run has begun since the edge at `edge_s`."""

    @property
    def edge_known(self) -> bool:
        """Whether `edge_s` is the edge of the run that begins next; if not, the report of its edge was lost."""
        # A passage may end without a pulse: its edge is not that of the next board.
        return not self._edge_taken and not self.over

    def begin_single(self, now_s: float) -> None:
        """Begin the passage of a single pulse, which no edge begins."""
        self.forget()
        self.edge_s, self._edge_taken = now_s, False

    def begin_run(self) -> list[Interruption]:
        """Return the interruptions of the run that begins. There are none if the report of its edge was lost."""
        if self.over:
            self.forget()
        self._edge_taken = True
        return self.interruptions

    def add(self, event: ControllerEvent, now_s: float) -> BoardMissed | None:
        """Add an edge to its passage. Return a report if it shows that a board passed without a run."""
        host_s = min(self._clock.host_s(event.time_s), now_s)
        if isinstance(event, BarrierBlocked):
            self.begin_single(host_s)
            self._block(event.time_s, event.counts)
        elif isinstance(event, BarrierBlockedAgain):
            self._block(event.time_s, event.counts)
        elif isinstance(event, BarrierClear):
            self._clear(event)
        elif isinstance(event, BarrierClearAfterRun):
            # What stays in the barrier after its run belongs to that run. Anything else was in the barrier before its
            # edge counted.
            if not (self.interruptions and self.interruptions[-1][1] is None):
                return BoardMissed(host_s, "it stood in the barrier when the line was armed")
            self._clear(event)
        elif isinstance(event, BoardTooSoon):
            self.forget()
            self._block(event.time_s, None)
            return BoardMissed(host_s, f"it came {event.gap_s:.3f} s after the one before had left")
        return None

    def _block(self, time_s: float, counts: int | None) -> None:
        if self.over:
            self.interruptions, self._counts, self.over = [], [], False
        self.interruptions.append((time_s, None))
        self._counts.append((counts, None))

    def _clear(self, event: BarrierEdge) -> None:
        # If the report of a beginning was lost, the previous interruption is taken to have lasted until now: an
        # interruption that is too long is noticed, one that is missing is not.
        if self.interruptions:
            self.interruptions[-1] = (self.interruptions[-1][0], event.time_s)
            self._counts[-1] = (self._counts[-1][0], event.counts)

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
    return (counts - zero + _WRAP // 2) % _WRAP - _WRAP // 2


STILL_S = 5.0
"""Shortest time without a row after which a belt that spaces the rows counts as stopped."""
UNREPORTED_S = 1.0
"""Time, s, in addition to the debounce, after which an interrupted barrier without a report of its edge belongs to a
board whose edge will not be reported."""


class PassageWatch:
    """Follows the events of the armed controller. Unlike the session, also those of a run that was given up."""

    def __init__(self) -> None:
        self._plan: TriggerPlan | None = None
        self._row_s: float | None = None
        """Host time of the run's latest row, or of its latest interruption of the barrier; None without a run."""
        self._blocked = False
        self.standing = False
        """Whether a board is in the barrier that is not filmed, because it came while the line was not armed."""
        self._unreported_s: float | None = None
        """Host time since which the barrier has been interrupted without a report; None if it is not."""

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
        self.standing = bool(blocked) and not self.passing

    def disarm(self) -> None:
        """Ignore events until the controller is armed again."""
        self._plan, self._row_s, self._blocked = None, None, False
        self.standing, self._unreported_s = False, None

    def check_level(self, blocked: bool | None, now_s: float) -> None:
        """Compare the level of the barrier, at most a heartbeat old, with what was reported; reports may be lost."""
        if self._plan is None or self._row_s is not None or blocked is None:
            self._unreported_s = None
        elif not blocked:
            self._blocked, self.standing, self._unreported_s = False, False, None
        elif not self.passing:
            # A level is often known sooner than the edge is reported, which waits for the debounce.
            self._unreported_s = now_s if self._unreported_s is None else self._unreported_s
            self.standing |= now_s - self._unreported_s > UNREPORTED_S + self._plan.debounce_s

    def forget_barrier(self) -> None:
        """Take the barrier as clear outside a run, because the report that it became clear may be lost."""
        self._blocked = self._blocked and self._row_s is not None

    def add(self, event: ControllerEvent, now_s: float) -> bool:
        """Evaluate an event; return whether it changed `passing`, `standing` or contacts of neighbours."""
        before = self.passing, self.standing
        if isinstance(event, ContactsChanged):
            return True
        if self._plan is None:
            return False
        if not isinstance(event, RunEnded | BarrierBounce):
            self.standing, self._unreported_s = False, None
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
