"""Compare the time stamps of a camera's frames with the pulses, on the two devices' own clocks.

Two crystals differ by an offset and a constant rate, and a triggered camera answers every pulse with the same delay:
camera time = a + (1 + s)·pulse time, up to a jitter of microseconds. s is the median over all pairs of frames (Theil,
1950; Sen, 1968), limited to what crystals can differ by; a is the median of the remainders. Outliers of less than a
third of the frames do not move the line.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.causes import id_step

MAX_DRIFT = 5e-4
"""Largest relative rate of two crystals within their specification."""
MAX_INTERVAL_DEVIATION = 0.01
"""Frames come by a free-running clock if their times deviate by less than this share of their interval."""


def residuals_s(pulse_s: Sequence[float], camera_s: Sequence[float]) -> NDArray[np.float64]:
    """Return time stamp minus the fitted line for every frame, s; zeros for fewer than two frames.

    Args:
        pulse_s: times of the pulses by the controller's clock, ascending.
        camera_s: time stamps of their frames by the camera's clock, in the same order.
    """
    x = np.asarray(pulse_s, dtype=np.float64) - (pulse_s[0] if pulse_s else 0.0)
    y = np.asarray(camera_s, dtype=np.float64) - (camera_s[0] if camera_s else 0.0) - x
    if len(x) < 2:
        return np.zeros(len(x))
    i, j = np.triu_indices(len(x), 1)
    # The limit matters with few frames: two wrong ones always lie on a line of some rate.
    rate = min(max(median((y[j] - y[i]) / (x[j] - x[i])), -MAX_DRIFT), MAX_DRIFT)
    left = y - rate * x
    return np.asarray(left - median(left))


def median(values: NDArray[np.float64] | Sequence[float]) -> float:
    """Return the median."""
    # np.median imports the module of masked arrays first, which takes 50 ms at the end of the first board.
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    return float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2


def free_running_interval_s(camera_s: Sequence[float], ids: Sequence[int]) -> float | None:
    """Return the interval of frames that come by a clock of their own; None if they do not.

    Args:
        camera_s: time stamps of the frames, ascending.
        ids: their frame ids; gaps from lost frames and the wrap of ids are allowed.
    """
    if len(ids) < 3:
        return None
    count = np.array([id_step(ids[0], i) for i in ids], dtype=np.float64)
    time_s = np.asarray(camera_s, dtype=np.float64) - camera_s[0]
    if (np.diff(count) <= 0).any():
        return None
    interval_s, start_s = np.polyfit(count, time_s, 1)
    off = np.abs(time_s - start_s - interval_s * count).max()
    return float(interval_s) if off < MAX_INTERVAL_DEVIATION * interval_s else None
