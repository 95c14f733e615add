"""The outages of cameras. An outage is the cause of the frames that are missing during it."""

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
    """The latest outages of every camera, by host time. During an outage the camera is called *away*."""

    def __init__(self, keep: int = 20) -> None:
        """Create an empty list of outages for each camera; at most `keep` are kept per camera."""
        self._outages: defaultdict[int, deque[_Outage]] = defaultdict(lambda: deque(maxlen=keep))

    def begin(self, camera: int, since_s: float, why: str) -> None:
        """Record that a camera has been away since `since_s`, because of `why`, which is a phrase for messages."""
        self._outages[camera].append(_Outage(since_s, math.inf, why))

    def end(self, camera: int, at_s: float) -> None:
        """Record that a camera delivers again from `at_s` on."""
        for outage in self._outages[camera]:
            outage.until_s = min(outage.until_s, at_s)

    def is_away(self, camera: int) -> bool:
        """Return whether a camera is away at present."""
        return any(math.isinf(outage.until_s) for outage in self._outages[camera])

    def count_ended(self, camera: int, host_s: float) -> int:
        """Return how many outages of a camera had ended by the host time `host_s`."""
        return sum(outage.until_s <= host_s for outage in self._outages[camera])

    def cause_at(self, camera: int, host_s: float) -> str:
        """Return why a camera was away at the time `host_s`; an empty text if it was not away."""
        return next(
            (f"the camera was lost: {o.why}" for o in self._outages[camera] if o.since_s <= host_s <= o.until_s), ""
        )
