"""Events of the controller that come too late: of a run that was closed, or a pulse that was given up."""

from __future__ import annotations

from math import inf

from vaoi_station.acquisition.clocks import ClockModel
from vaoi_station.acquisition.controller.interface import BarrierBlocked, ControllerEvent, RunEnded


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
        """Use the events of a pulse that was fired, from a host time on; those before it stay outdated.

        Args:
            earliest_s: the time of its command, less the error that the controller's clock may have.
        """
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
