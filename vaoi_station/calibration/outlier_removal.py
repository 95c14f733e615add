"""Removal of marks that are inconsistent with the others: a smudge, a bubble in the print, another object."""

from __future__ import annotations

import numpy as np

from vaoi_station.calibration.homography_fit import Fit, fit_camera
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats, apply

_MIN_REMAINING = 5
"""Four marks fit without residuals, so of five marks none can be identified as the outlier."""
_MAX_REMOVED_SHARE = 0.4
_MAX_TRIALS = 12
"""Number of leave-one-out fits per outlier. They leave out the marks with the largest residuals."""
_SIGMAS, _MIN_ERROR_PX = 6.0, 0.1
"""Smallest prediction error of an outlier, in standard deviations and in px."""
_RAYLEIGH = 1.1774
"""Median length of a vector of two independent normal variables, divided by their standard deviation."""


def remove_outliers(fit: Fit, marks_mm: Floats, px: Floats) -> tuple[Fit, list[int]]:
    """Remove, one by one, the marks whose measured position contradicts the prediction from the other marks.

    Args:
        fit: the fit of all marks.
        marks_mm: (k, 2) tester coordinates.
        px: (k, 2) raw pixels.

    Returns:
        The fit of the remaining marks, and their indices.
    """
    kept = list(range(len(px)))
    least = max(_MIN_REMAINING, int(np.ceil((1 - _MAX_REMOVED_SHARE) * len(px))))
    while len(kept) > least:
        better = _leave_one_out(fit, marks_mm, px, kept)
        if better is None:
            break
        fit, kept = better
    return fit, kept


def _leave_one_out(fit: Fit, marks_mm: Floats, px: Floats, kept: list[int]) -> tuple[Fit, list[int]] | None:
    """Return the best fit without one mark, if noise does not explain the error of that mark, else None."""
    best: tuple[float, Fit, list[int]] | None = None
    lengths = np.hypot(*fit.residuals_px.T)
    # The median is robust against the outliers that are still in the fit.
    usual = float(np.median(lengths)) / _RAYLEIGH * np.sqrt(2 * len(kept) / max(fit.freedom, 1))
    # The largest residual need not be the outlier's: a least-squares fit bends towards it. So each candidate is left
    # out in turn, and predicted by the others.
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
