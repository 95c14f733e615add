"""Removal of marks that contradict the others: a smudge, a bubble in the print, another object."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

from vaoi_station.calibration.homography_fit import Fit, estimate_homography, fit_camera
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats, apply

_MIN_REMAINING = 5
"""Least number of marks that must remain. Four marks fit without residuals, so of five none can be named an outlier."""
_MAX_REMOVED_SHARE = 0.4
_MAX_TRIALS = 12
"""Number of fits with one mark left out, per search for an outlier; those with the largest residuals are tried."""
_SIGMAS, _MIN_ERROR_PX = 6.0, 0.1
"""Smallest prediction error of an outlier, in standard deviations and in px."""
_MAX_SUBSETS, _MAX_STARTS, _MAX_ROUNDS = 100, 3, 10
_CLEARLY_BETTER = 4.0
"""Least factor between the residuals of two fits, for one to be clearly better. Leaving out marks at random gives
less."""
_RAYLEIGH = 1.1774
"""Median length of a vector of two independent normal variables, divided by their standard deviation."""


def remove_outliers(fit: Fit, marks_mm: Floats, px: Floats) -> tuple[Fit, list[int]]:
    """Remove the marks whose measured position contradicts the prediction from the other marks.

    Marks are removed one by one. If there are several outliers, they can bend the fit so that a good mark has larger
    residuals than they have. Therefore, if two marks were removed or the residuals are still large, a second search
    starts from minimal subsets of the marks. Its outcome replaces that of the first search only if it excludes a mark
    that the first search kept. Return the fit of the remaining marks, and their indices.
    """
    kept = list(range(len(px)))
    least = max(_MIN_REMAINING, int(np.ceil((1 - _MAX_REMOVED_SHARE) * len(px))))
    while len(kept) > least:
        better = _leave_one_out(fit, marks_mm, px, kept)
        if better is None:
            break
        fit, kept = better
    # A single outlier cannot be masked.
    sound = len(kept) >= len(px) - 1 and float(np.hypot(*fit.residuals_px.T).max()) <= _MIN_ERROR_PX
    if sound or len(px) <= least:
        return fit, kept
    best = fit, kept
    for start in _robust_starts(marks_mm, px, least):
        grown = _grow(fit, start, marks_mm, px, least)
        if grown is not None and set(kept) - set(grown[1]) and _is_better(grown, best):
            best = grown
    return best


def _is_better(this: tuple[Fit, list[int]], other: tuple[Fit, list[int]]) -> bool:
    """Return whether a fit explains more marks, or about as many with far smaller residuals."""
    (fit, kept), (other_fit, other_kept) = this, other
    if fit.rms_px * _CLEARLY_BETTER < other_fit.rms_px:
        return True
    return len(kept) > len(other_kept) and fit.rms_px < _CLEARLY_BETTER * other_fit.rms_px


def _robust_starts(marks_mm: Floats, px: Floats, least: int) -> list[list[int]]:
    """Return sets of `least` marks that agree best with the homography of four of them (least quantile of squares)."""
    n = len(px)
    if math.comb(n, 4) <= _MAX_SUBSETS:
        subsets = [list(subset) for subset in combinations(range(n), 4)]
    else:
        # If two fifths are outliers, one of eight subsets contains none. The seed is fixed, so that equal marks give
        # equal outliers.
        g = np.random.default_rng(0)
        subsets = [g.choice(n, 4, replace=False).tolist() for _ in range(_MAX_SUBSETS)]
    found: list[tuple[float, list[int]]] = []
    for subset in subsets:
        h = estimate_homography(px[subset], marks_mm[subset])
        if h is None:
            continue
        with np.errstate(all="ignore"):  # A wrong homography may map a mark to infinity.
            error = np.hypot(*(px - apply(h, marks_mm)).T)
        nearest = np.argsort(np.where(np.isfinite(error), error, np.inf), kind="stable")[:least]
        if np.isfinite(error[nearest[-1]]):
            found.append((float(error[nearest[-1]]), sorted(nearest.tolist())))
    found.sort()
    return [marks for _, marks in found[:_MAX_STARTS]]


def _grow(fit: Fit, start: list[int], marks_mm: Floats, px: Floats, least: int) -> tuple[Fit, list[int]] | None:
    """Fit a set of marks, then replace it by all marks that agree with the fit, until the set no longer changes.

    Return None if a fit fails.
    """
    kept = start
    for _ in range(_MAX_ROUNDS):
        trial = fit_camera(marks_mm[kept], px[kept], fit.prior)
        if isinstance(trial, Failure):
            return None
        error = np.hypot(*(trial.lens.undistort(px) - apply(trial.matrix, marks_mm)).T)
        # Marks outside the set are extrapolated. So the uncertainty of the prediction is added to that of the mark.
        limit = np.maximum(_SIGMAS * np.hypot(trial.sigma_px, trial.sigma_at_px(px)), _MIN_ERROR_PX)
        agreeing = np.flatnonzero(error <= limit).tolist()
        if agreeing == kept:
            return trial, kept
        if len(agreeing) < least:
            return None
        kept = agreeing
    return None


def _leave_one_out(fit: Fit, marks_mm: Floats, px: Floats, kept: list[int]) -> tuple[Fit, list[int]] | None:
    """Return the best fit without one mark, if noise does not explain the error of that mark, else None."""
    best: tuple[float, Fit, list[int]] | None = None
    lengths = np.hypot(*fit.residuals_px.T)
    # The median is robust against the outliers that are still in the fit.
    usual = float(np.median(lengths)) / _RAYLEIGH * np.sqrt(2 * len(kept) / max(fit.freedom, 1))
    # The outlier need not have the largest residual, because a least-squares fit bends towards it. So each candidate is
    # left out in turn and predicted from the others.
    for n in np.argsort(-lengths)[:_MAX_TRIALS]:
        rest = [k for m, k in enumerate(kept) if m != n]
        trial = fit_camera(marks_mm[rest], px[rest], fit.prior)
        if isinstance(trial, Failure):
            continue
        left, out = px[kept[n]], marks_mm[kept[n]]
        off = float(np.hypot(*(trial.lens.undistort(left) - apply(trial.matrix, out))))
        if off > max(_SIGMAS * usual, _MIN_ERROR_PX) and (best is None or trial.rms_px < best[0]):
            best = trial.rms_px, trial, rest
    return None if best is None else best[1:]
