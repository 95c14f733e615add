"""The dark level and the read noise of a camera, from frames of darkness.

Grey levels of darkness are cut off at zero, so that their mean is too large and their scatter too small. Both are
therefore taken from the part of the distribution that is not cut off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.photometry.noise import Floats32

_INNER = (0.03, 0.97)
"""Shares of the distribution between which it is fitted: hot pixels are in its upper end."""
_LEAST_SIGMA = 0.3
"""Least read noise in grey levels; quantisation alone is 0.29."""
SMOOTHING_PX = 10.0
"""σ of the smoothing of maps. It removes noise, and keeps what lenses, lamps and sensors do on larger scales."""
_WINDOW_PX = 15
"""Side of the window in which the variance of single pixels is compared with that of noise."""
_LEAST_STRUCTURE = 0.1
"""Standard deviation, grey levels, of the dark level over the frame, below which one number is used for all pixels."""
_NOISE_MARGIN = 1.15
"""Factor on the variance of noise, below which scatter from pixel to pixel counts as noise."""


@dataclass(frozen=True, eq=False)
class Darkness:
    """The dark level of one camera and its read noise, in grey levels."""

    level: float
    read: float
    map: Floats32 | None
    """(h, w) dark level pixel by pixel, where it differs; otherwise None."""


def measure_darkness(frames: Sequence[Floats32]) -> Darkness:
    """Measure the darkness of one camera from grey levels (h, w) of n frames of darkness."""
    level, read = uncut_normal(np.concatenate([frame.ravel()[::7] for frame in frames]))
    mean = np.mean(np.stack(frames), axis=0, dtype=np.float32)
    # Hot pixels and columns stay in the map; its mean is shifted by what is cut off at zero.
    shifted = np.asarray(mean - np.float32(mean.mean() - level), dtype=np.float32)
    smooth = cv2.GaussianBlur(shifted, (0, 0), SMOOTHING_PX, borderType=cv2.BORDER_REFLECT)
    found = smooth + without_noise(shifted - smooth, np.float32(read**2 / len(frames)))
    varies = float(found.std()) > _LEAST_STRUCTURE
    return Darkness(max(level, 0.0), read, np.asarray(found, dtype=np.float32) if varies else None)


def uncut_normal(values: NDArray[np.float32]) -> tuple[float, float]:
    """Estimate mean and standard deviation of normal values that were rounded, and cut off at zero.

    A line is fitted to the quantiles of the distribution, at the limits between neighbouring grey levels.
    """
    levels, counts = np.unique(values, return_counts=True)
    share = np.cumsum(counts)[:-1] / counts.sum()
    limits = (levels[:-1] + levels[1:]) / 2
    inner = (share > _INNER[0]) & (share < _INNER[1])
    if inner.sum() < 2:
        return float(values.mean()), max(float(values.std()), _LEAST_SIGMA)
    share, limits = share[inner], limits[inner]
    normal = NormalDist()
    quantile = np.array([normal.inv_cdf(p) for p in share])
    density = np.exp(-(quantile**2) / 2)
    slope, offset = np.polyfit(limits, quantile, 1, w=density / np.sqrt(share * (1 - share)))
    return float(-offset / slope), max(float(1 / slope), _LEAST_SIGMA)


def without_noise(residual: NDArray[np.float32], variance: NDArray[np.float32] | np.float32) -> NDArray[np.float32]:
    """Reduce residuals (h, w) of single pixels to the share that is more than noise of a known variance.

    Where residuals scatter as noise does, nothing is left; where they scatter more, as at dust, they are kept.
    """
    local = cv2.blur(np.square(residual), (_WINDOW_PX, _WINDOW_PX), borderType=cv2.BORDER_REFLECT)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip(1 - _NOISE_MARGIN * variance / local, 0, 1)
    return np.asarray(np.nan_to_num(share) * residual, dtype=np.float32)
