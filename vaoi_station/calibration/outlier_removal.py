"""Marks that do not fit the others: a smudge, a bubble in the print, a stranger mistaken for a mark."""

from __future__ import annotations

import numpy as np

from vaoi_station.calibration.homography_fit import Fit, fit_camera
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats, apply

_LEAST_LEFT = 5
"""Four marks fit anything, so the last five say nothing about one of them."""
_MOST_SHARE = 0.4
_TRIED = 12
"""In how many leave-one-out fits the culprit is sought: those of the largest residuals."""
_SIGMAS, _LEAST_PX = 6.0, 0.1
_RAYLEIGH = 1.1774
"""Median length of a vector of two normal numbers, in their standard deviation; outliers do not move a median."""


def remove_outliers(fit: Fit, marks_mm: Floats, px: Floats) -> tuple[Fit, list[int]]:
    """Leave out marks, one by one, whose place the others predict otherwise.

    Args:
        fit: of all the marks.
        marks_mm: (k, 2) tester coordinates.
        px: (k, 2) raw pixels.

    Returns:
        The fit of the marks kept, and their indices.
    """
    kept = list(range(len(px)))
    least = max(_LEAST_LEFT, int(np.ceil((1 - _MOST_SHARE) * len(px))))
    while len(kept) > least:
        better = _leave_one_out(fit, marks_mm, px, kept)
        if better is None:
            break
        fit, kept = better
    return fit, kept


def _leave_one_out(fit: Fit, marks_mm: Floats, px: Floats, kept: list[int]) -> tuple[Fit, list[int]] | None:
    """The fit without the mark that disturbs most, if it is off by more than noise explains."""
    best: tuple[float, Fit, list[int]] | None = None
    lengths = np.hypot(*fit.residuals_px.T)
    usual = float(np.median(lengths)) / _RAYLEIGH * np.sqrt(2 * len(kept) / max(fit.freedom, 1))
    for n in np.argsort(-lengths)[:_TRIED]:
        rest = [k for m, k in enumerate(kept) if m != n]
        trial = fit_camera(marks_mm[rest], px[rest], fit.lens.center_px, fit.lens.radius_px)
        if isinstance(trial, Failure):
            continue
        left, out = px[kept[n]], marks_mm[kept[n]]
        off = float(np.hypot(*(trial.lens.undistort(left) - apply(trial.matrix, out))))
        if off > max(_SIGMAS * usual, _LEAST_PX) and (best is None or trial.rms_px < best[0]):
            best = trial.rms_px, trial, rest
    return None if best is None else best[1:]
