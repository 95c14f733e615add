"""To which passage of the barrier an edge belongs, and which boards passed without a run."""

from __future__ import annotations

from vaoi_station.acquisition.clocks import ClockModel
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierBlockedAgain,
    BarrierClear,
    BarrierClearAfterRun,
    BoardTooSoon,
    ControllerEvent,
)
from vaoi_station.acquisition.process.barrier_log import BarrierLog
from vaoi_station.acquisition.process.messages import BoardMissed


class PassageLog:
    """Collects the confirmed edges of the barrier, passage by passage."""

    def __init__(self, clock: ClockModel) -> None:
        """Begin without a passage.

        Args:
            clock: maps the controller's times to the host's clock.
        """
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
