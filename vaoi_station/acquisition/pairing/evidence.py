"""What the frame ids and time stamps of a camera show. Pure logic.

A time stamp shows to which pulse a frame belongs; a frame id shows what was lost, because a camera counts the frames
that it sends: a gap is a loss in transfer, and a missing frame without a gap was never exposed. Time stamp = a + (1 +
s)·pulse time up to microseconds; s is the median slope over all pairs of frames (Theil, 1950; Sen, 1968), which
tolerates 29 % of outliers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

MAX_FRAME_ID, MAX_EXTENDED_ID = 0xFFFF, 0xFFFF_FFFF_FFFF_FFFF

NO_PACKET = (
    "the camera answers, but not one packet of a frame has arrived since it was opened; check that no firewall of this "
    "computer or switch drops its UDP packets, and that its trigger line is wired"
)


def id_step(first: int, second: int) -> int:
    """Return the number of frames from id `first` to id `second`. Ids may wrap to their start in between."""
    step = second - first
    # An id above 65535 proves 64-bit ids.
    largest = MAX_EXTENDED_ID if max(first, second) > MAX_FRAME_ID else MAX_FRAME_ID
    # Half the range separates a wrap from a step back.
    if abs(step) <= largest // 2:
        return step
    return step + largest if step < 0 else step - largest


@dataclass(frozen=True)
class Gap:
    """The interval between two frames of one camera: how many pulses were fired, and how often the camera exposed."""

    before: int
    after: int
    ids: tuple[int, int]
    pulses: int
    """Count of pulses fired after the pulse of row `before`, up to and including the pulse of row `after`."""
    exposed: int
    """Count of frames that the camera exposed in the gap, according to its frame ids."""
    missing: tuple[int, ...]
    """Rows between `before` and `after` of which no frame arrived."""

    @property
    def unanswered(self) -> int:
        """Count of pulses in the interval on which the camera did not expose.

        A negative value counts exposures without a pulse. A value above the number of missing rows means that the
        frame ids contradict the time stamps.
        """
        return self.pulses - self.exposed

    @property
    def span(self) -> str:
        """The frame ids at both ends, and the count of pulses, as a text for causes and findings."""
        return f"(frame ids {self.ids[0]} → {self.ids[1]} over {self.pulses} pulses)"


def in_counting_order(ids: Mapping[int, int]) -> dict[int, int]:
    """Return the same rows and frame ids, with the ids assigned to the rows in ascending order: {row: id}."""
    rows = sorted(ids)
    if not rows:
        return {}
    first = ids[rows[0]]
    return dict(zip(rows, sorted((ids[row] for row in rows), key=lambda i: id_step(first, i)), strict=True))


def find_gaps(
    fired: Sequence[int], ids: Mapping[int, int], incomplete: AbstractSet[int], unassigned_ids: Sequence[int]
) -> list[Gap]:
    """Return, for one camera, the intervals between consecutive frames that have a frame id."""
    # Ids are sorted first: next to an exchanged frame one interval would be negative and the other too large.
    ids = in_counting_order(ids)
    place = {row: n for n, row in enumerate(fired)}
    found = []
    for before, after in pairwise(sorted(row for row in ids if row in place)):
        step = id_step(ids[before], ids[after])
        # The camera counts unassigned frames too. If they were not subtracted, they would hide unanswered pulses.
        extra = sum(1 for i in unassigned_ids if 0 < id_step(ids[before], i) < step)
        between = fired[place[before] + 1 : place[after]]
        missing = tuple(row for row in between if row not in incomplete)
        pulses = place[after] - place[before]
        found.append(Gap(before, after, (ids[before], ids[after]), pulses, step - extra, missing))
    return found


def explain_missing(row: int, numbered: AbstractSet[int], gaps: Sequence[Gap], unassigned: int = 0) -> str:
    """Return a text that states why a row has no frame."""
    if not numbered:
        return (
            f"the camera sent {unassigned} frame(s) in this run, but no time stamp fits a pulse"
            if unassigned
            else "the camera sent no frame in this run; check its cable, its power and its trigger line"
        )
    gap = next((g for g in gaps if row in g.missing), None)
    if gap is None:
        return "no frame arrived for the first pulses" if row < min(numbered) else "no frame arrived after the last one"
    if gap.unanswered == 0:
        return f"lost in transfer: the camera counted it {gap.span}"
    if gap.unanswered == len(gap.missing):
        return f"the camera did not expose: its frame ids have no gap {gap.span}"
    if 0 < gap.unanswered < len(gap.missing):
        share = f"{gap.unanswered} of {len(gap.missing)} such pulses"
        return f"lost in transfer, or not exposed, as {share} were; the frame ids do not show which {gap.span}"
    return f"lost, and the frame ids do not show how {gap.span}"


GATE_S = 0.010
"""Largest accepted difference between a frame's latency and that of its camera, if the configuration gives none, s."""
ENOUGH = 3
"""Number of frames, from the first pulses of a run, that confirm a latency which is far from the expected one."""
MAX_DRIFT = 5e-4
"""Largest relative difference in rate between two crystal clocks within their specification."""
MAX_INTERVAL_DEVIATION = 0.01
"""A camera runs freely if its time stamps deviate from equal intervals by less than this share of the interval."""


def residuals_s(pulse_s: Sequence[float], camera_s: Sequence[float]) -> NDArray[np.float64]:
    """Return time stamp minus the fitted line for every frame, s; zeros for fewer than two frames."""
    x = np.asarray(pulse_s, dtype=np.float64) - (pulse_s[0] if pulse_s else 0.0)
    y = np.asarray(camera_s, dtype=np.float64) - (camera_s[0] if camera_s else 0.0) - x
    if len(x) < 2:
        return np.zeros(len(x))
    i, j = np.triu_indices(len(x), 1)
    # The limit matters for few frames: any two points lie exactly on a line, even if one belongs to another pulse.
    rate = min(max(median((y[j] - y[i]) / (x[j] - x[i])), -MAX_DRIFT), MAX_DRIFT)
    left = y - rate * x
    return np.asarray(left - median(left))


def median(values: NDArray[np.float64] | Sequence[float]) -> float:
    """Return the median of the values."""
    # np.median imports NumPy's masked arrays at its first use, which would delay the end of the first board by 50 ms.
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    return float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2


def free_running_interval_s(camera_s: Sequence[float], ids: Sequence[int]) -> float | None:
    """Return the interval of a camera that runs freely, s; None if its frames do not come at equal intervals."""
    if len(ids) < 3:
        return None
    count = np.array([id_step(ids[0], i) for i in ids], dtype=np.float64)
    time_s = np.asarray(camera_s, dtype=np.float64) - camera_s[0]
    if (np.diff(count) <= 0).any():
        return None
    interval_s, start_s = np.polyfit(count, time_s, 1)
    off = np.abs(time_s - start_s - interval_s * count).max()
    return float(interval_s) if off < MAX_INTERVAL_DEVIATION * interval_s else None
