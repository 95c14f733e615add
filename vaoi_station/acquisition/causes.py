"""What the numbers tell that a camera gives its frames: why a frame is missing, and whether two are exchanged.

Time stamps say which pulse a frame belongs to; frame ids say what was lost: a camera counts the frames
it sends, so a gap in its ids is a loss on the way, and a missing frame without a gap was never exposed.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from itertools import pairwise

WRAP = 65535
"""GigE Vision counts 1 … 65535 and then 1 again; 0 never occurs. Extended ids do not wrap in our lifetime."""


def id_step(first: int, second: int) -> int:
    """Frames from one id to another; a small id after a large one has wrapped."""
    step = second - first
    if abs(step) <= WRAP // 2 or max(first, second) > WRAP:
        return step
    return step + WRAP if step < 0 else step - WRAP


@dataclass(frozen=True)
class Gap:
    """Between the frames of two rows of a camera: what its count says of the pulses in between."""

    before: int
    after: int
    ids: tuple[int, int]
    pulses: int
    """Fired from `before` to `after`, that of `after` included."""
    exposed: int
    """Frames the camera counted for them."""
    missing: tuple[int, ...]
    """Rows of which nothing came."""

    @property
    def ignored(self) -> int:
        """Pulses without an exposure; below 0: exposures without a pulse; more than are missing: a contradiction."""
        return self.pulses - self.exposed

    @property
    def span(self) -> str:
        """What was counted, in words."""
        return f"(frame ids {self.ids[0]} → {self.ids[1]} over {self.pulses} pulses)"


def straightened(ids: Mapping[int, int]) -> dict[int, int]:
    """The ids of rows in the order in which a camera counts: the same as given, unless some are exchanged."""
    rows = sorted(ids)
    if not rows:
        return {}
    first = ids[rows[0]]
    return dict(zip(rows, sorted((ids[row] for row in rows), key=lambda i: id_step(first, i)), strict=True))


def gaps(fired: Sequence[int], ids: Mapping[int, int], torn: AbstractSet[int], strays: Sequence[int]) -> list[Gap]:
    """What lies between the numbered frames of a camera.

    Args:
        fired: rows whose pulse was fired, in order.
        ids: row → frame id, of the rows that have.
        torn: rows of which something came without an id.
        strays: ids of frames that belong to no row.
    """
    ids = straightened(ids)
    place = {row: n for n, row in enumerate(fired)}
    found = []
    for before, after in pairwise(sorted(row for row in ids if row in place)):
        step = id_step(ids[before], ids[after])
        extra = sum(1 for s in strays if 0 < id_step(ids[before], s) < step)
        between = fired[place[before] + 1 : place[after]]
        missing = tuple(row for row in between if row not in torn)
        pulses = place[after] - place[before]
        found.append(Gap(before, after, (ids[before], ids[after]), pulses, step - extra, missing))
    return found


def explain_missing(row: int, have: AbstractSet[int], between: Sequence[Gap]) -> str:
    """Why one row has no frame; `have`: the numbered rows of its camera, `between`: the gaps that they leave."""
    if not have:
        return "the camera sent no frame in this run"
    gap = next((g for g in between if row in g.missing), None)
    if gap is None:
        return "no frame came for the first pulses" if row < min(have) else "no frame came after the last one seen"
    if gap.ignored == 0:
        return f"lost on the way: the camera counted it {gap.span}"
    if gap.ignored == len(gap.missing):
        return f"the camera did not expose: its count goes on without a gap {gap.span}"
    if 0 < gap.ignored < len(gap.missing):
        share = f"{gap.ignored} of {len(gap.missing)} such pulses"
        return f"lost, or ignored by the camera, as {share} were; its count does not tell which {gap.span}"
    return f"lost, and the camera's count does not tell how {gap.span}"


@dataclass
class _Outage:
    since_s: float
    until_s: float
    why: str


class Outages:
    """When each camera was away (host time), for the rows it missed meanwhile."""

    def __init__(self, keep: int = 20) -> None:
        self._outages: defaultdict[int, deque[_Outage]] = defaultdict(lambda: deque(maxlen=keep))

    def lost(self, camera: int, since_s: float, why: str) -> None:
        """It has not been seen since."""
        self._outages[camera].append(_Outage(since_s, math.inf, why))

    def back(self, camera: int, at_s: float) -> None:
        """It films again."""
        for outage in self._outages[camera]:
            outage.until_s = min(outage.until_s, at_s)

    def away(self, camera: int) -> bool:
        """Whether it has been lost and is not back."""
        return any(math.isinf(outage.until_s) for outage in self._outages[camera])

    def before(self, camera: int, host_s: float) -> int:
        """How many have ended by then."""
        return sum(outage.until_s <= host_s for outage in self._outages[camera])

    def at(self, camera: int, host_s: float) -> str:
        """Why a camera was away at a time; empty if it was not."""
        return next(
            (f"the camera was lost: {o.why}" for o in self._outages[camera] if o.since_s <= host_s <= o.until_s), ""
        )
