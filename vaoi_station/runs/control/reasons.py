"""The station's state, and the reasons for it that `GET station` and the page show."""

from __future__ import annotations

import re
import time
from collections.abc import Callable

from vaoi_station.acquisition.process.messages import Trouble
from vaoi_station.errors import StateError
from vaoi_station.model import Reason
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.tables import ADVICE, STATION, StationState, StationStep

TROUBLE_S = 10.0
"""Time after which a trouble expires if the device does not report it again, s."""
_WORD = re.compile(r"[a-z]+(?=[ :])")


def sentence(text: str) -> str:
    """Write the first letter of a text as a capital, unless the text begins with a file, a field or a number."""
    return text[0].upper() + text[1:] if _WORD.match(text) else text


class Reasons:
    """Reasons, oldest first: those that are held stay until they are dropped, troubles of devices expire."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._reasons: dict[str, Reason] = {}
        self._reported_s: dict[str, float] = {}
        """Time of the latest report of each trouble, by its key."""
        self._outdated: set[str] = set()
        """Keys of the troubles that were reported by an acquisition process that has ended."""

    def hold(self, reason: Reason) -> bool:
        """Add a reason in place of an earlier one with its code. Return False if the same reason is present."""
        before = self._reasons.pop(reason.code, None)
        self._reasons[reason.code] = reason  # A repeated reason moves to the end, after the trouble that caused it.
        return before != reason

    def mark_outdated(self) -> None:
        """Let the next reported trouble replace all present ones; until then the operator can act on them only."""
        self._outdated = set(self._reported_s)

    def trouble(self, report: Trouble) -> Reason | None:
        """Add the trouble of a device as a reason, and return the reason; None if the trouble is present already."""
        key = f"{report.code}: {report.message}"
        for old in self._outdated - {key}:
            self._forget(old)
        self._outdated = set()
        self._reported_s[key] = self._clock()
        if key in self._reasons:
            return None
        self._reasons[key] = Reason(code=report.code, message=sentence(report.message), action=report.action)
        return self._reasons[key]

    def drop(self, code: str) -> None:
        """Remove the reason with this code, if it is present."""
        self._reasons.pop(code, None)

    def clear(self) -> None:
        """Remove all reasons, and all troubles of devices."""
        self._reasons.clear()
        self._reported_s.clear()
        self._outdated = set()

    def expire(self) -> None:
        """Remove the troubles that have not been reported again for `TROUBLE_S`."""
        now_s = self._clock()
        for key in [key for key, at_s in self._reported_s.items() if now_s - at_s > TROUBLE_S]:
            self._forget(key)

    def all(self) -> tuple[Reason, ...]:
        """Return all present reasons and troubles, the oldest first."""
        return tuple(self._reasons.values())

    def _forget(self, key: str) -> None:
        del self._reported_s[key]
        self._outdated.discard(key)
        self._reasons.pop(key, None)


class StationStateMachine:
    """The state of the station by the table `STATION`. Every change is published as an event. Used by one thread."""

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
        """Change to the state that follows a step; ignore one that is illegal, as reports after a fault or a stop."""
        if STATION.allows(self.state, event):
            self.advance(event)

    def add_reason(self, code: str, message: str, action: str) -> None:
        """Add a reason for the present state, and publish it unless the same reason is present already."""
        if self.reasons.hold(Reason(code=code, message=message, action=action)):
            self._events.add("trouble", message, code=code, action=action)
