"""The encoder of the simulated belt: the times of its counts while a board passes."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vaoi_station.geometry.transforms import Floats

_STEP_S = 1e-3
"""Interval of the belt's way between which counts are interpolated; its speed varies over tenths of a second."""
_LONGEST_S = 600.0


@dataclass(frozen=True, eq=False)
class EncoderTrack:
    """The counts of one passage, from 0 at its start. Times are in seconds since the start of the passage."""

    steps_s: Floats
    """(k,) time of every count, the first one first."""

    def counts_at(self, time_s: float) -> int:
        """Return the counts up to a time."""
        return bisect_right(self.steps_s, time_s)

    def time_of(self, counts: int) -> float:
        """Return the time at which a count is reached; infinite if it is beyond the track."""
        if counts < 1:
            return 0.0
        return float(self.steps_s[counts - 1]) if counts <= len(self.steps_s) else math.inf


def encoder_track(way_mm: Callable[[float], float], counts_per_mm: float, length_mm: float) -> EncoderTrack:
    """Return the counts of a belt.

    Args:
        way_mm: the belt's way since the start of the passage, which never decreases.
        counts_per_mm: counts per mm of the way.
        length_mm: the way up to which counts are computed.
    """
    ends = 1.0
    while way_mm(ends) < length_mm and ends < _LONGEST_S:
        ends *= 2
    times = np.arange(0.0, ends + _STEP_S, _STEP_S)
    ways = np.array([way_mm(float(t)) for t in times])
    counts = np.arange(1, math.floor(min(length_mm, ways[-1]) * counts_per_mm) + 1)
    # Where the belt stands still, the way has one value at several times; the count comes when it moves on.
    moving = np.concatenate([[True], np.diff(ways) > 0])
    return EncoderTrack(np.interp(counts / counts_per_mm, ways[moving], times[moving]))
