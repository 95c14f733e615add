"""Whether a board is in the barrier or passing the cameras, by the controller's events, for the heartbeat.

The station films from the first pulse on. A board comes into the barrier before that, and with rows by the way of the
belt it may stand there for any time.
"""

from __future__ import annotations

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
        """Follow events from now on. The events of an arming before this one end with those of its run.

        `blocked`: the level of the barrier after the controller was armed; None if it is not known.
        """
        self._plan = plan
        self._standing = bool(blocked) and not self.passing

    def disarm(self) -> None:
        """Ignore events until the controller is armed again."""
        self._plan, self._row_s, self._blocked = None, None, False
        self._standing, self._unreported_s = False, None

    def check_level(self, blocked: bool | None, now_s: float) -> None:
        """Compare the level of the barrier with what was reported. Reports may be lost, and a controller may restart.

        `blocked`: the level, at most a heartbeat old; None if it is not known.
        """
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
