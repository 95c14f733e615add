"""Counts and waiting times, for the metrics, of the runs that were announced since the station was started."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections import Counter
from dataclasses import dataclass, field

from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.runs.states.timeline_schemas import Timeline

LATENCY_BOUNDS_S = (0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
"""Upper bounds, s, of the classes into which the times from the last frame to the result are counted."""


@dataclass(frozen=True)
class RunFigures:
    """The counts and waiting times of runs at one moment."""

    verdicts: dict[str, int]
    """Number of runs for each verdict; `none` for runs without a result."""
    frames: dict[str, int]
    """Number of frames for each verdict of a frame."""
    latencies: tuple[int, ...] = (0,) * (len(LATENCY_BOUNDS_S) + 1)
    """Number of results in each class of `LATENCY_BOUNDS_S`; the last class is above all bounds."""
    latency_sum_s: float = 0.0


@dataclass
class RunStatistics:
    """Adds up the figures of runs. Its methods may be called from any thread."""

    _verdicts: Counter[str] = field(default_factory=Counter)
    _frames: Counter[str] = field(default_factory=Counter)
    _latencies: list[int] = field(default_factory=lambda: [0] * (len(LATENCY_BOUNDS_S) + 1))
    _sum_s: float = 0.0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def add(self, detail: RunDetail, timeline: Timeline) -> None:
        """Count a run that has ended."""
        with self._lock:
            self._verdicts[str(detail.verdict) if detail.verdict else "none"] += 1
            self._frames.update(detail.counts.model_dump())
            if timeline.ready_s is not None:
                waited_s = max(timeline.ready_s - timeline.last_frame_s, 0.0)
                self._latencies[bisect_left(LATENCY_BOUNDS_S, waited_s)] += 1
                self._sum_s += waited_s

    def figures(self) -> RunFigures:
        """Return the counts and waiting times up to now."""
        with self._lock:
            return RunFigures(dict(self._verdicts), dict(self._frames), tuple(self._latencies), self._sum_s)
