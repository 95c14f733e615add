"""Record when cameras were away, so that the frames they missed have that cause."""

from __future__ import annotations

import math
from collections import defaultdict, deque
from dataclasses import dataclass


@dataclass
class _Outage:
    since_s: float
    until_s: float
    why: str


class Outages:
    """The latest outages of every camera, in host time."""

    def __init__(self, keep: int = 20) -> None:
        """Keep at most `keep` outages per camera."""
        self._outages: defaultdict[int, deque[_Outage]] = defaultdict(lambda: deque(maxlen=keep))

    def begin(self, camera: int, since_s: float, why: str) -> None:
        """Record that a camera has been away since a time."""
        self._outages[camera].append(_Outage(since_s, math.inf, why))

    def end(self, camera: int, at_s: float) -> None:
        """Record that a camera delivers again."""
        for outage in self._outages[camera]:
            outage.until_s = min(outage.until_s, at_s)

    def is_away(self, camera: int) -> bool:
        """Whether a camera was lost and has not come back."""
        return any(math.isinf(outage.until_s) for outage in self._outages[camera])

    def count_ended(self, camera: int, host_s: float) -> int:
        """Count the outages of a camera that had ended by a time."""
        return sum(outage.until_s <= host_s for outage in self._outages[camera])

    def cause_at(self, camera: int, host_s: float) -> str:
        """Return why a camera was away at a time; empty if it was not."""
        return next(
            (f"the camera was lost: {o.why}" for o in self._outages[camera] if o.since_s <= host_s <= o.until_s), ""
        )
