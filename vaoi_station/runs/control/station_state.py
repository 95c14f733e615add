"""The state of the station and its reasons. The table `states.tables.STATION` defines the legal changes of state."""

from __future__ import annotations

from vaoi_station.errors import StateError
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.control.reasons import Reasons
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import Reason
from vaoi_station.runs.states.tables import ADVICE, STATION, StationState, StationStep


class StationStateMachine:
    """The present state of the station, its start time and its reasons. Used by one thread.

    Every change of state is published as an event.
    """

    def __init__(self, events: EventLog) -> None:
        self._events = events
        self.state: StationState = STATION.start
        self.since = utc()
        self.reasons = Reasons()

    def require(self, event: StationStep) -> None:
        """Raise StateError, with the first reason, if the step is illegal in the present state."""
        if not STATION.allows(self.state, event):
            reason = next(iter(self.reasons.all()), None)
            why = f" ({reason.message})" if reason else ""
            message = f"The station is {self.state}{why}; {event!s} is not possible now."
            raise StateError(message, action=ADVICE.get(self.state, ""))

    def advance(self, event: StationStep) -> None:
        """Change to the state that follows a step. Raise StateError if the step is illegal in the present state."""
        state = STATION.next(self.state, event)
        if state is not self.state:
            self.state, self.since = state, utc()
            self._events.add("station", f"The station is {state}.", state=state)

    def advance_if_allowed(self, event: StationStep) -> None:
        """Change to the state that follows a step; ignore a step that is illegal in the present state."""
        # Devices report asynchronously: a Disarmed or RunFinished message may arrive after a fault or a stop.
        if STATION.allows(self.state, event):
            self.advance(event)

    def add_reason(self, code: str, message: str, action: str) -> None:
        """Add a reason for the present state, and publish it unless the same reason is present already."""
        if self.reasons.hold(Reason(code=code, message=message, action=action)):
            self._events.add("trouble", message, code=code, action=action)
