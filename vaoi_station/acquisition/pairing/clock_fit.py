"""Do the frames of a camera keep time with the pulses? Arithmetic on two clocks.

Two crystals differ by an offset and a constant rate, and a triggered camera answers every pulse with the same delay:
camera time = a + (1 + s)·pulse time, up to a jitter of microseconds. The rate is the median of all pairs' (Theil, 1950;
Sen, 1968), within what crystals can differ; a is the median of what is left. Less than a third of the frames may be
anything without moving the line.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.causes import id_step

FASTEST_DRIFT = 5e-4
"""Largest relative rate of two crystals that are as they should be."""
REGULAR = 0.01
"""Frames whose times are even to this share of their interval come by a clock."""


def residuals_s(pulse_s: Sequence[float], camera_s: Sequence[float]) -> NDArray[np.float64]:
    """How far each frame is from where the others say that it should be, s; zeros for fewer than two frames."""
    x = np.asarray(pulse_s, dtype=np.float64) - (pulse_s[0] if pulse_s else 0.0)
    y = np.asarray(camera_s, dtype=np.float64) - (camera_s[0] if camera_s else 0.0) - x
    if len(x) < 2:
        return np.zeros(len(x))
    i, j = np.triu_indices(len(x), 1)
    rate = min(max(middle((y[j] - y[i]) / (x[j] - x[i])), -FASTEST_DRIFT), FASTEST_DRIFT)
    left = y - rate * x
    return np.asarray(left - middle(left))


def middle(values: NDArray[np.float64] | Sequence[float]) -> float:
    """The median. (NumPy's own loads a module of masked arrays first: 50 ms at the end of the first board.)"""
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    return float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2


def steady_interval_s(camera_s: Sequence[float], ids: Sequence[int]) -> float | None:
    """Time from one frame of a camera to the next, if they come by a clock of their own; in order of time."""
    if len(ids) < 3:
        return None
    count = np.array([id_step(ids[0], i) for i in ids], dtype=np.float64)
    time_s = np.asarray(camera_s, dtype=np.float64) - camera_s[0]
    if (np.diff(count) <= 0).any():
        return None
    interval_s, start_s = np.polyfit(count, time_s, 1)
    off = np.abs(time_s - start_s - interval_s * count).max()
    return float(interval_s) if off < REGULAR * interval_s else None
