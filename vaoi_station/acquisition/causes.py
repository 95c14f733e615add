"""Why a frame is missing, in words, from the numbers the camera gave its other frames.

Time stamps say which pulse a frame belongs to; frame ids say what was lost: a camera counts the frames
it sends, so a gap in its ids is a loss on the way, and a missing frame without a gap was never exposed.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

WRAP = 65535
"""GigE Vision counts 1 … 65535 and then 1 again; 0 never occurs. Extended ids do not wrap in our lifetime."""


def id_step(first: int, second: int) -> int:
    """Frames from one id to another; a small id after a large one has wrapped."""
    step = second - first
    return step + WRAP if step < -WRAP // 2 and first <= WRAP else step


def explain_missing(row: int, ids: Mapping[int, int], strays: Sequence[int]) -> str:
    """Why one row has no frame. `ids`: row → frame id of the rows that have; `strays`: ids of unclaimed frames."""
    before = max((r for r in ids if r < row), default=None)
    after = min((r for r in ids if r > row), default=None)
    if before is None and after is None:
        return "the camera sent no frame in this run"
    if before is None or after is None:
        return "no frame came for the first pulses" if before is None else "no frame came after the last one seen"
    step, pulses = id_step(ids[before], ids[after]), after - before
    span = f"(frame ids {ids[before]} → {ids[after]} over {pulses} pulses)"
    extra = sum(1 for s in strays if 0 < id_step(ids[before], s) < step)
    if step - extra == pulses:
        return f"lost on the way: the camera counted it {span}"
    if step - extra == 1:
        return f"the camera did not expose: its count goes on without a gap {span}"
    return f"lost, and the camera's count does not tell how {span}"


def contradictions(ids: Mapping[int, int], strays: Sequence[int]) -> dict[int, str]:
    """Rows whose frame id does not fit their place: row → what is odd about it."""
    notes = {}
    for before, after in pairwise(sorted(ids)):
        step, pulses = id_step(ids[before], ids[after]), after - before
        extra = sum(1 for s in strays if 0 < id_step(ids[before], s) < step)
        if step <= 0 or step - extra > pulses:
            notes[after] = f"its frame id is {ids[after]}, {pulses} pulse(s) before it was {ids[before]}"
    return notes


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

    def at(self, camera: int, host_s: float) -> str:
        """Why a camera was away at a time; empty if it was not."""
        return next(
            (f"the camera was lost: {o.why}" for o in self._outages[camera] if o.since_s <= host_s <= o.until_s), ""
        )
