"""Reasons for the station's state: those that hold until they are removed, and troubles that expire."""

from __future__ import annotations

import re
import time
from collections.abc import Callable

from vaoi_station.acquisition.process.messages import Trouble
from vaoi_station.runs.states.schemas import Reason

TROUBLE_S = 10.0
"""A trouble that was not reported again for this time is over."""

_WORD = re.compile(r"[a-z]+(?=[ :])")


def sentence(text: str) -> str:
    """Capitalize a text, unless it begins with a file, a field or a figure."""
    return text[0].upper() + text[1:] if _WORD.match(text) else text


class Reasons:
    """The reasons that a status page shows, oldest first; used by one thread."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._reasons: dict[str, Reason] = {}
        self._reported_s: dict[str, float] = {}
        """When each trouble was last reported."""
        self._outdated: set[str] = set()
        """Troubles of a process that has ended."""

    def hold(self, reason: Reason) -> bool:
        """Add a reason under its code, until `drop`; False if the same reason was there already."""
        before = self._reasons.pop(reason.code, None)
        self._reasons[reason.code] = reason  # a repeated reason moves behind the trouble that led to it
        return before != reason

    def mark_outdated(self) -> None:
        """Let the next trouble replace all present ones: the devices are opened again."""
        # They are not dropped yet: while the devices open, the old cause is all that the operator can act on.
        self._outdated = set(self._reported_s)

    def trouble(self, report: Trouble) -> Reason | None:
        """Add a device's trouble; None if the same was reported shortly before."""
        key = f"{report.code}: {report.message}"
        for old in self._outdated - {key}:
            del self._reported_s[old]
            self._reasons.pop(old, None)
        self._outdated = set()
        self._reported_s[key] = self._clock()
        if key in self._reasons:
            return None
        self._reasons[key] = Reason(code=report.code, message=sentence(report.message), action=report.action)
        return self._reasons[key]

    def drop(self, code: str) -> None:
        """Remove a reason; harmless if there is none."""
        self._reasons.pop(code, None)

    def clear(self) -> None:
        """Remove all reasons and troubles."""
        self._reasons.clear()
        self._reported_s.clear()
        self._outdated = set()

    def expire(self) -> None:
        """Remove troubles that were not reported lately."""
        now = self._clock()
        for key in [key for key, at in self._reported_s.items() if now - at > TROUBLE_S]:
            del self._reported_s[key]
            self._outdated.discard(key)
            self._reasons.pop(key, None)

    def all(self) -> tuple[Reason, ...]:
        """All present reasons, oldest first."""
        return tuple(self._reasons.values())
