"""Compare the time stamps of a camera's frames with the pulse times, without the host's clock.

Time stamps come from the camera's clock, pulse times from the controller's clock. The two clocks differ by an offset
and a constant rate, and a triggered camera answers every pulse with the same delay. Therefore time stamp = a + (1 +
s)·pulse time, up to a jitter of microseconds. s is the median slope over all pairs of frames (Theil, 1950; Sen, 1968),
limited to ± `MAX_DRIFT`. a is the median of time stamp − (1 + s)·pulse time. The estimate tolerates up to about 29 %
outliers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.causes import id_step

MAX_DRIFT = 5e-4
"""Largest relative difference in rate between two crystal clocks within their specification."""
MAX_INTERVAL_DEVIATION = 0.01
"""A camera runs freely if its time stamps deviate from equal intervals by less than this share of the interval."""


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
    """Return the interval of a camera that runs freely, s; None if its frames do not come at equal intervals.

    Args:
        camera_s: time stamps of the frames, ascending.
        ids: frame ids of the same frames; they may have gaps from lost frames and may wrap.
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
