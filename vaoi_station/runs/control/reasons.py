"""Reasons for the station's state. They stay until they are removed; troubles of devices also expire by themselves."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence

from vaoi_station.acquisition.process.messages import Trouble
from vaoi_station.runs.states.schemas import Reason
from vaoi_station.supervised_thread import ThreadFault

TROUBLE_S = 10.0
"""Time after which a trouble expires if the device does not report it again, s."""

_WORD = re.compile(r"[a-z]+(?=[ :])")


def sentence(text: str) -> str:
    """Write the first letter of a text as a capital, unless the text begins with a file, a field or a number."""
    return text[0].upper() + text[1:] if _WORD.match(text) else text


def thread_reasons(faults: Sequence[ThreadFault]) -> tuple[Reason, ...]:
    """Return one reason per thread of the station that has ended or hangs."""
    action = "The station ends and is started again by systemd."
    return tuple(Reason(code="thread-lost", message=str(fault), action=action) for fault in faults)


class Reasons:
    """The reasons for the station's state, which `GET station` and the page show, oldest first. Used by one thread."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._reasons: dict[str, Reason] = {}
        self._reported_s: dict[str, float] = {}
        """Time of the latest report of each trouble, by its key, in seconds of the clock."""
        self._outdated: set[str] = set()
        """Keys of the troubles that were reported by an acquisition process that has ended."""

    def hold(self, reason: Reason) -> bool:
        """Add a reason, which stays until `drop` is called with its code. Return False if the same reason is present.

        The reason replaces an earlier one with the same code.
        """
        before = self._reasons.pop(reason.code, None)
        self._reasons[reason.code] = reason  # A repeated reason moves to the end, after the trouble that caused it.
        return before != reason

    def mark_outdated(self) -> None:
        """Mark all present troubles as outdated. The next reported trouble then replaces them."""
        # They are not removed yet: while the devices are being opened, the old cause is all that the operator can act
        # on.
        self._outdated = set(self._reported_s)

    def trouble(self, report: Trouble) -> Reason | None:
        """Add the trouble of a device as a reason, and return the reason; None if the trouble is present already."""
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
        """Remove the reason with this code, if it is present."""
        self._reasons.pop(code, None)

    def clear(self) -> None:
        """Remove all reasons, and all troubles of devices."""
        self._reasons.clear()
        self._reported_s.clear()
        self._outdated = set()

    def expire(self) -> None:
        """Remove the troubles that have not been reported again for `TROUBLE_S`."""
        now = self._clock()
        for key in [key for key, at in self._reported_s.items() if now - at > TROUBLE_S]:
            del self._reported_s[key]
            self._outdated.discard(key)
            self._reasons.pop(key, None)

    def all(self) -> tuple[Reason, ...]:
        """Return all present reasons and troubles, the oldest first."""
        return tuple(self._reasons.values())
