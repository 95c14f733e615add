"""The outages of cameras and the jumps of their clocks.

An outage is the cause of the frames that are missing from its time. Frames that arrive between the two readings of a
clock that has jumped cannot be dated: the old and the new time are both possible.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from dataclasses import dataclass

from vaoi_station.acquisition.clocks import ClockJump


@dataclass
class _Outage:
    since_s: float
    until_s: float
    why: str


class Outages:
    """The latest outages and clock jumps of every camera. During an outage the camera is called *away*."""

    def __init__(self, keep: int = 20) -> None:
        """Create empty lists of outages and clock jumps; at most `keep` of each are kept per camera."""
        self._jumps: defaultdict[int, deque[ClockJump]] = defaultdict(lambda: deque(maxlen=keep))
        self._outages: defaultdict[int, deque[_Outage]] = defaultdict(lambda: deque(maxlen=keep))

    def begin(self, camera: int, since_s: float, why: str) -> None:
        """Record that a camera has been away since `since_s`, because of `why`, which is a phrase for messages."""
        self._outages[camera].append(_Outage(since_s, math.inf, why))

    def end(self, camera: int, at_s: float) -> None:
        """Record that a camera delivers again from `at_s` on."""
        for outage in self._outages[camera]:
            outage.until_s = min(outage.until_s, at_s)

    def add_jump(self, camera: int, jump: ClockJump) -> None:
        """Record a jump of a camera's clock."""
        self._jumps[camera].append(jump)

    def jump_between(self, camera: int, first_s: float, last_s: float) -> ClockJump | None:
        """Return the jump of a camera's clock that makes its times between two host times unknown, if there is one."""
        return next((j for j in self._jumps[camera] if j.since_s <= last_s and first_s <= j.until_s), None)

    def is_away(self, camera: int) -> bool:
        """Return whether a camera is away at present."""
        return any(math.isinf(outage.until_s) for outage in self._outages[camera])

    def count_ended(self, camera: int, host_s: float) -> int:
        """Return how many outages and clock jumps of a camera had ended by the host time `host_s`."""
        ends_s = (*(o.until_s for o in self._outages[camera]), *(j.until_s for j in self._jumps[camera]))
        return sum(end_s <= host_s for end_s in ends_s)

    def cause_at(self, camera: int, host_s: float) -> str:
        """Return why a camera was away at the time `host_s`; an empty text if it was not away."""
        return next(
            (f"the camera was lost: {o.why}" for o in self._outages[camera] if o.since_s <= host_s <= o.until_s), ""
        )
