"""The brightness of a white target over one frame, from several rows, with its noise and signs that it is no target.

Rows are divided by their brightness and averaged without what only one of them shows, because dust on the target moves
with it. The average is smoothed wherever neighbouring pixels differ by no more than their noise, so that four rows
suffice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.photometry.darkness import SMOOTHING_PX, without_noise
from vaoi_station.photometry.noise import Floats32

_BLOCK_PX = 16
"""Side of the blocks to which the polynomial over the frame is fitted."""
_DEGREE = 4
_OUTLIER = 4.0
"""Deviations from the median of the rows, in standard deviations, that are left out of the mean."""
_WIDE_PX = 31
"""Side of the window over which the noise of single pixels is averaged."""
_TRIM = 5.0
"""Variances above this multiple of their median belong to dust or to motion, not to noise."""
_STRUCTURE_PX = 20.0
"""σ of the smoothing that separates structure of a target from the shading of lens and lamp."""
_LEAST = 1e-3
"""Least relative brightness that is divided by."""
_SUBSAMPLE = 4
_BINS = 16


@dataclass(frozen=True, eq=False)
class WhiteTarget:
    """A white target as one camera sees it under one light."""

    surface: Floats32
    """(h, w) grey levels per unit of exposure · gain."""
    flicker: float
    """Largest deviation of the brightness of a row from the median of the rows, as a share."""
    structure: float
    """Rms deviation from a smooth surface, without noise, as a share of the brightness."""
    motion: float
    """Rms change from row to row, without noise, as a share of the brightness."""
    darkest: float
    """Brightness of the darkest place of the frame as a share of the mean."""
    signals: NDArray[np.float64]
    """(k,) signals in grey levels at which the noise was measured."""
    variances: NDArray[np.float64]
    """(k,) variances there, in squared grey levels."""

    @property
    def level(self) -> float:
        """Mean of the surface."""
        return float(self.surface.mean(dtype=np.float64))


def combine(signals: Sequence[Floats32], scales: Sequence[float]) -> WhiteTarget:
    """Combine n ≥ 2 rows (h, w) of grey levels whose dark level is subtracted.

    Args:
        signals: the rows.
        scales: exposure · gain of each row.
    """
    centres = np.array([float(np.median(s[::_SUBSAMPLE, ::_SUBSAMPLE])) for s in signals])
    rates = centres / np.asarray(scales)
    rate, centre = float(np.median(rates)), float(centres.mean())
    stack = np.stack([s / np.float32(c) for s, c in zip(signals, centres, strict=True)])
    middle = np.asarray(np.median(stack, axis=0), dtype=np.float32)
    variance = np.asarray(np.var(stack, axis=0, ddof=1), dtype=np.float32)
    limit = np.float32(_TRIM * float(np.median(variance[::_SUBSAMPLE, ::_SUBSAMPLE])))
    local = _mean_where(variance, variance <= limit, _WIDE_PX)
    kept = np.abs(stack - middle) <= _OUTLIER * np.sqrt(local)
    mean = np.asarray((stack * kept).sum(0) / np.maximum(kept.sum(0), 1), dtype=np.float32)
    shape = _polynomial(mean)
    smooth = _smooth(mean, shape, SMOOTHING_PX)
    residual = mean / smooth - 1
    noise = np.asarray(local / (np.square(smooth) * len(signals)), dtype=np.float32)
    fine = without_noise(residual, noise)
    moving = [cv2.blur(row - middle, (7, 7), borderType=cv2.BORDER_REFLECT) for row in stack]
    # Noise is averaged away over 7×7 pixels; what remains moves, or is structure.
    still = cv2.blur(mean / _smooth(mean, shape, _STRUCTURE_PX), (5, 5), borderType=cv2.BORDER_REFLECT) - 1
    return WhiteTarget(
        np.asarray(smooth * (1 + fine) * np.float32(rate), dtype=np.float32),
        float(np.abs(rates / rate - 1).max()),
        float(np.sqrt(np.mean(np.square(still), dtype=np.float64))),
        float(np.sqrt(np.mean(np.square(moving), dtype=np.float64) * len(signals) / (len(signals) - 1))),
        float(smooth.min() / smooth.mean()),
        *_binned(smooth * np.float32(centre), variance * np.float32(centre) ** 2, variance <= limit),
    )


def _smooth(mean: Floats32, shape: Floats32, sigma_px: float) -> Floats32:
    """Smooth the ratio of a picture (h, w) to a surface near it, which avoids a shift at the borders."""
    ratio = cv2.GaussianBlur(mean / shape, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT)
    return np.maximum(np.asarray(shape * ratio, dtype=np.float32), np.float32(_LEAST))


def _polynomial(mean: Floats32) -> Floats32:
    """Fit a polynomial of degree 4 to a picture (h, w), and return its values."""
    h, w = mean.shape
    blocks = cv2.resize(mean, (max(w // _BLOCK_PX, 2), max(h // _BLOCK_PX, 2)), interpolation=cv2.INTER_AREA)
    by, bx = (np.polynomial.legendre.legvander(_centres(n), _DEGREE) for n in blocks.shape)
    powers = [(a, b) for a in range(_DEGREE + 1) for b in range(_DEGREE + 1 - a)]
    columns = np.stack([np.outer(by[:, a], bx[:, b]).ravel() for a, b in powers], -1)
    values = np.linalg.lstsq(columns, blocks.ravel().astype(np.float64), rcond=None)[0]
    coefficients = np.zeros((_DEGREE + 1, _DEGREE + 1))
    for (a, b), value in zip(powers, values, strict=True):
        coefficients[a, b] = value
    y, x = (np.polynomial.legendre.legvander(_centres(n), _DEGREE) for n in (h, w))
    return np.maximum((y @ coefficients @ x.T).astype(np.float32), np.float32(_LEAST))


def _centres(n: int) -> NDArray[np.float64]:
    """Return the centres of n equal parts of −1 … 1."""
    return np.asarray((np.arange(n) + 0.5) * 2 / n - 1)


def _mean_where(values: Floats32, chosen: NDArray[np.bool_], side_px: int) -> Floats32:
    """Return the mean of the chosen values (h, w) in a window around each pixel; the mean of all where none is."""
    weight = chosen.astype(np.float32)
    window = (side_px, side_px)
    total = cv2.blur(values * weight, window, borderType=cv2.BORDER_REFLECT)
    share = cv2.blur(weight, window, borderType=cv2.BORDER_REFLECT)
    overall = np.float32(values[chosen].mean()) if chosen.any() else np.float32(values.mean())
    return np.asarray(np.where(share > _LEAST, total / np.maximum(share, _LEAST), overall), dtype=np.float32)


def _binned(
    signal: Floats32, variance: Floats32, chosen: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Average variances over bins of equal numbers of pixels of similar signal: signals (k,) and variances (k,)."""
    s, v = (a[chosen].astype(np.float64) for a in (signal, variance))
    order = np.array_split(np.argsort(s), _BINS)
    means = [(s[part].mean(), v[part].mean()) for part in order if len(part)]
    return np.array([m[0] for m in means]), np.array([m[1] for m in means])
