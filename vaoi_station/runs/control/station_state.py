"""The state of the station with its reasons, changed only as the table `states.tables.STATION` allows."""

from __future__ import annotations

from vaoi_station.errors import StateError
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.control.reasons import Reasons
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import Reason
from vaoi_station.runs.states.tables import ADVICE, STATION, StationState, StationStep


class StationStateMachine:
    """Current state, since when, and why; every change is published as an event. Confined to one thread."""

    def __init__(self, events: EventLog) -> None:
        self._events = events
        self.state: StationState = STATION.start
        self.since = utc()
        self.reasons = Reasons()

    def require(self, event: StationStep) -> None:
        """Raise `StateError`, with the first reason of the present state, unless the event is possible now."""
        if not STATION.allows(self.state, event):
            reason = next(iter(self.reasons.all()), None)
            why = f" ({reason.message})" if reason else ""
            message = f"The station is {self.state}{why}; {event!s} is not possible now."
            raise StateError(message, action=ADVICE.get(self.state, ""))

    def advance(self, event: StationStep) -> None:
        """Follow the table; `StateError` if the event is illegal in the present state."""
        state = STATION.next(self.state, event)
        if state is not self.state:
            self.state, self.since = state, utc()
            self._events.add("station", f"The station is {state}.", state=state)

    def advance_if_allowed(self, event: StationStep) -> None:
        """Follow the table where the event is legal, and ignore it elsewhere."""
        # Devices report asynchronously: a Disarmed or RunFinished may arrive after a fault or a stop.
        if STATION.allows(self.state, event):
            self.advance(event)

    def add_reason(self, code: str, message: str, action: str) -> None:
        """Give the present state a reason, and publish it unless it is known."""
        if self.reasons.hold(Reason(code=code, message=message, action=action)):
            self._events.add("trouble", message, code=code, action=action)
