"""Why the station is as it is: reasons that hold until they are taken back, and troubles that pass by themselves."""

from __future__ import annotations

import re
import time
from collections.abc import Callable

from vaoi_station.acquisition.process.messages import Trouble
from vaoi_station.runs.states.schemas import Reason

TROUBLE_S = 10.0
"""A trouble that has not been told of again for so long is over."""

_WORD = re.compile(r"[a-z]+(?=[ :])")


def sentence(text: str) -> str:
    """With a capital letter in front, unless it begins with a file, a field or a figure."""
    return text[0].upper() + text[1:] if _WORD.match(text) else text


class Reasons:
    """What a status page shows under "why"; one thread uses it."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._reasons: dict[str, Reason] = {}
        self._told_s: dict[str, float] = {}
        """When the devices last told of a trouble."""
        self._outdated: set[str] = set()
        """Troubles of a process that has ended."""

    def hold(self, reason: Reason) -> bool:
        """From now on this is so, its code is its name; False if it was so already."""
        before = self._reasons.pop(reason.code, None)
        self._reasons[reason.code] = reason  # behind what led to it
        return before != reason

    def begin_anew(self) -> None:
        """The devices are opened once more: what is told of them next takes the place of what was told before."""
        self._outdated = set(self._told_s)

    def trouble(self, report: Trouble) -> Reason | None:
        """A device complains; None if it has complained of the same just before."""
        key = f"{report.code}: {report.message}"
        for old in self._outdated - {key}:
            del self._told_s[old]
            self._reasons.pop(old, None)
        self._outdated = set()
        self._told_s[key] = self._clock()
        if key in self._reasons:
            return None
        self._reasons[key] = Reason(code=report.code, message=sentence(report.message), action=report.action)
        return self._reasons[key]

    def drop(self, code: str) -> None:
        """This is no longer so; harmless if it was not."""
        self._reasons.pop(code, None)

    def clear(self) -> None:
        """Everything is well."""
        self._reasons.clear()
        self._told_s.clear()
        self._outdated = set()

    def expire(self) -> None:
        """Drop troubles nobody has complained of lately."""
        now = self._clock()
        for key in [key for key, at in self._told_s.items() if now - at > TROUBLE_S]:
            del self._told_s[key]
            self._outdated.discard(key)
            self._reasons.pop(key, None)

    def all(self) -> tuple[Reason, ...]:
        """Everything that holds, oldest first."""
        return tuple(self._reasons.values())
