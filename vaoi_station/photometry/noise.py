"""Grey levels of frames: what they were taken with, where they are saturated, and the noise of their camera."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Floats32 = NDArray[np.float32]

FULL_SCALE = 255.0
"""Largest grey level, in the unit of this package."""
_BLOCK_PX = 12
"""Side of the blocks of which the noise is estimated. One block has 144 residuals, so its variance is good to 17 %."""
_SMOOTHEST = 0.1
"""Share of the blocks of similar brightness that count as smooth."""
_QUANTILE_FACTOR = 1.25
"""Expected variance over the mean variance of the smoothest tenth of noisy blocks without texture."""
_LEAST_BLOCKS = 50
"""Least number of blocks in a bin of brightness."""
_BINS = np.linspace(0.0, FULL_SCALE, 17)
_LINEAR_BELOW = 240.0
"""Blocks whose mean is above this grey level may contain saturated pixels, which have no noise."""
_CLIPPED_BELOW = 6.0
"""Blocks whose mean is below this grey level may be clipped at zero."""
_LEAST_READ, _LEAST_SHOT = 0.3, 1e-4
"""Least read noise in grey levels (quantisation alone is 0.29) and least shot noise."""
_KERNEL = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
"""Second difference along both axes: zero for ramps, and variance 1 for noise of variance 1."""


@dataclass(frozen=True)
class NoiseModel:
    """Variance of a grey level: read² + shot · gain · (grey − dark), in squared 8-bit grey levels."""

    read: float = 1.0
    """Standard deviation of a dark pixel in grey levels, with quantisation."""
    shot: float = 0.02
    """Grey levels of variance per grey level of signal, at gain 1."""

    def variance(self, signal: Floats32, gain: float = 1.0) -> Floats32:
        """Return the variance of grey levels whose dark level is subtracted, in squared grey levels."""
        return np.asarray(self.read**2 + self.shot * gain * np.maximum(signal, 0), dtype=np.float32)


def grey_levels(pixels: NDArray[Any]) -> Floats32:
    """Convert a frame (h, w) or (h, w, 3) of 8 or 16 bits to grey levels 0 … 255 with fractions, float32."""
    grey = pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY))
    return np.asarray(grey, dtype=np.float32) * np.float32(1.0 if grey.dtype == np.uint8 else FULL_SCALE / 65535)


def noise_from_frames(frames: Iterable[NDArray[Any]], dark: float = 0.0) -> NoiseModel:
    """Estimate the noise from frames of boards, by their smoothest places; `dark` is the grey level of darkness.

    In each bin of brightness, the smoothest tenth of small blocks is assumed to have no texture. A line through the
    variances of the bins gives read and shot noise. Where the frames have too few such places, typical values remain.
    Three or four frames of different exposures are enough.
    """
    means: list[Floats32] = []
    variances: list[Floats32] = []
    for frame in frames:
        grey = grey_levels(frame)
        residual = cv2.filter2D(grey, -1, _KERNEL)
        size = (grey.shape[1] // _BLOCK_PX, grey.shape[0] // _BLOCK_PX)
        if min(size) < 1:
            continue
        area = np.s_[: size[1] * _BLOCK_PX, : size[0] * _BLOCK_PX]
        means.append(_blocks(grey[area]))
        variances.append(_blocks(residual[area] ** 2))
    if not means:
        return NoiseModel()
    mean, variance = np.concatenate(means), np.concatenate(variances)
    # Blocks of one single grey level are saturated or black, and have no noise to measure.
    good = (mean < _LINEAR_BELOW) & (mean > _CLIPPED_BELOW) & (variance > 0)
    levels, spreads, counts = [], [], []
    for low, high in pairwise(_BINS):
        chosen = good & (mean >= low) & (mean < high)
        if chosen.sum() >= _LEAST_BLOCKS:
            order = np.sort(variance[chosen])[: max(int(chosen.sum() * _SMOOTHEST), 1)]
            levels.append(float(mean[chosen].mean()) - dark)
            spreads.append(float(order.mean()) * _QUANTILE_FACTOR)
            counts.append(float(len(order)))
    return fit_line(np.array(levels), np.array(spreads), np.array(counts))


def fit_line(levels: NDArray[np.float64], variances: NDArray[np.float64], counts: NDArray[np.float64]) -> NoiseModel:
    """Fit read and shot noise to variances (k,) at signals (k,); `counts` are the numbers of values behind each.

    Both are at least small positive values, because a variance of zero would give a pixel all the weight.
    """
    typical = NoiseModel()
    if not len(levels):
        return typical
    spread = float(np.ptp(levels))
    weight = np.sqrt(counts) / np.maximum(variances, 1e-3)
    if len(levels) < 2 or spread < 0.1 * float(levels.max()):
        # One brightness alone cannot separate the two. The typical ratio is kept.
        expected = typical.read**2 + typical.shot * float(np.average(levels, weights=counts))
        scale = float(np.average(variances, weights=counts)) / expected
        return NoiseModel(typical.read * scale**0.5, typical.shot * scale)
    shot, read2 = np.polyfit(levels, variances, 1, w=weight)
    if read2 < _LEAST_READ**2:
        shot, read2 = float(np.average(variances / np.maximum(levels, 1.0), weights=counts)), _LEAST_READ**2
    return NoiseModel(float(max(read2, _LEAST_READ**2)) ** 0.5, float(max(shot, _LEAST_SHOT)))


def _blocks(values: Floats32) -> Floats32:
    """Return the means of blocks of `_BLOCK_PX` along each axis, (k,)."""
    h, w = (n // _BLOCK_PX for n in values.shape)
    return np.asarray(values.reshape(h, _BLOCK_PX, w, _BLOCK_PX).mean((1, 3)).ravel(), dtype=np.float32)


class Taken(NamedTuple):
    """What a frame was taken with."""

    exposure_us: float
    gain: float = 1.0
    light: str | None = None


def is_saturated(pixels: NDArray[Any]) -> NDArray[np.bool_]:
    """Return where a frame (h, w) or (h, w, 3) of 8 or 16 bits is saturated, or touches a saturated pixel: (h, w)."""
    # Interpolation and the lens mix the pixels around a saturated one with it.
    return np.asarray(cv2.dilate(pixels_at_limit(pixels).astype(np.uint8), np.ones((3, 3), np.uint8)), np.bool_)


def pixels_at_limit(pixels: NDArray[Any]) -> NDArray[np.bool_]:
    """Return where a channel of a frame (h, w) or (h, w, 3) of 8 or 16 bits has its largest value: (h, w)."""
    full = FULL_SCALE if pixels.dtype == np.uint8 else 65535
    if pixels.ndim == 3:
        # By OpenCV, because numpy takes ten times as long to reduce an axis of three channels.
        blue, green, red = cv2.split(pixels)
        pixels = np.asarray(cv2.max(cv2.max(blue, green), red))
    return np.asarray(pixels >= full)
