"""Robust estimation, and estimates that can fail: these return a value, or a `Failure` that states why.

A failed estimate is a value and not an exception, because the caller decides what it means for the run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vaoi_station.errors import InternalError
from vaoi_station.geometry.transforms import Floats, Similarity, System

_ROUNDING = 1e-12  # largest distance of points that count as equal, relative to their coordinates: rounding errors only
_UNRELATED = 1e-12  # a fit fails if it explains less than this share of the squared spread of the target points


@dataclass(frozen=True)
class Failure:
    """The failure of an estimate, with a sentence that states why it is not possible, with numbers."""

    reason: str
    code: str = ""  # code of the failure, if it can become a reason of a verdict (`ReasonCode`); otherwise empty


def fit_similarity(
    target_points: ArrayLike, source_points: ArrayLike, target: System, source: System, *, mirrored: bool
) -> Similarity | Failure:
    """Fit a least-squares similarity of given handedness (four parameters; equation 21 for two points).

    Args:
        target_points: (k, 2) points, each the image of the source point with the same index.
        source_points: (k, 2) points, k ≥ 2, at least two of them different.
        target: system of `target_points`.
        source: system of `source_points`.
        mirrored: whether the mapping changes handedness; it is known and never estimated from the data.

    Raises:
        InternalError: if the numbers of points differ.
    """
    p, q = np.asarray(source_points, dtype=np.float64), np.asarray(target_points, dtype=np.float64)
    if p.shape != q.shape:
        raise InternalError(f"fit_similarity pairs {p.shape} with {q.shape} points")
    if len(p) < 2:
        return Failure(f"{len(p)} point(s) do not fix a similarity; two are needed")
    # A plane similarity is one complex factor: q = k·p + t. A mirrored one acts on the conjugate of p.
    flip = np.array([1.0, -1.0 if mirrored else 1.0])
    mid_p, mid_q = p.mean(0), q.mean(0)
    a = ((p - mid_p) * flip) @ np.array([1, 1j])
    b = (q - mid_q) @ np.array([1, 1j])
    spread = float((np.abs(a) ** 2).sum())
    if _coincide(a, p):
        return Failure("all points coincide; two different ones are needed")
    if _coincide(b, q):
        return Failure("the target points coincide; two different ones are needed")
    k = complex((np.conj(a) * b).sum() / spread)
    # A pattern that fits only its mirror image gives k ≈ 0, which would map all points to a single one.
    if abs(k) ** 2 * spread <= _UNRELATED * float((np.abs(b) ** 2).sum()):
        return Failure("the two sets of points have nothing in common under this handedness")
    linear = Similarity.of(abs(k), math.atan2(k.imag, k.real), (0, 0), target, source, mirrored=mirrored)
    return Similarity.of(abs(k), linear.angle_rad, mid_q - linear(mid_p), target, source, mirrored=mirrored)


def _coincide(offsets: NDArray[np.complex128], points: Floats) -> bool:
    """Return whether all points are equal, except for rounding errors.

    Args:
        offsets: (k,) offsets of the points from their mean, as complex numbers.
        points: (k, 2) the points.
    """
    return float(np.abs(offsets).max()) <= _ROUNDING * float(np.abs(points).max(initial=0.0))


def huber_weights(normalized: Floats, knee: float) -> Floats:
    """Compute the weights of Huber's M-estimator.

    Args:
        normalized: residuals divided by their standard deviations.
        knee: absolute value above which a residual loses weight.
    """
    size = np.abs(normalized)
    return np.asarray(np.where(size <= knee, 1.0, knee / np.maximum(size, 1e-12)))


def median_sigma(residuals: ArrayLike) -> float:
    """Estimate the standard deviation of residuals r as 1.4826 · median |r|. It is NaN without data.

    The factor is right for normally distributed residuals with mean 0.
    """
    r = np.asarray(residuals, dtype=np.float64)
    return 1.4826 * float(np.median(np.abs(r))) if r.size else math.nan
