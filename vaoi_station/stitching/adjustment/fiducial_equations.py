"""Set up the equations of detected fiducials, and the prior equation of the scale of C."""

from __future__ import annotations

import numpy as np

from vaoi_station.geometry.robust import huber_weights
from vaoi_station.geometry.similarity import apply_similarity, similarity_jacobian
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.observations import Ints
from vaoi_station.stitching.adjustment.problem import FiducialPoints

_SINGLE_PX, _COMMON_PX = 0.002, 0.004
"""Standard deviations of two errors of a detection that `sigma_mm` does not include.

`_SINGLE_PX` is independent for each detection. `_COMMON_PX` is common to all detections of one fiducial (artwork,
light) and does not average out (docs/measured/uncertainty.md)."""
_SCALE_SIGMA = 3e-4
"""Standard deviation of the relative size of a board against its CAD data: boards shrink and stretch."""
_KNEE, _CUT = 2.0, 6.0
"""Residuals beyond `_KNEE` standard deviations lose weight (Huber). Fixture marks and reference points, of which there
are many, have no weight beyond `_CUT` standard deviations."""

Equations = tuple[Ints, Floats, Floats]
"""k sets of r whitened equations a·δ + b ≈ 0 in f unknowns: columns (k, f) of the unknowns, a (k, r, f), b (k, r)."""


def fiducial_residuals(
    points: FiducialPoints, motion: Motion, c: Floats, basis: Floats, surface_mm: Floats
) -> tuple[Floats, Floats]:
    """Return the residuals (s, 2) of s detections in mm, and their Jacobian (s, 2, 3 + 4 + f).

    The Jacobian contains the derivatives by (φ, sx, sy) of the row, by the four numbers of C, and by the f coefficients
    of the surface.

    Args:
        points: the detections.
        motion: the motion of the rows.
        c: the similarity C as (a, b, x, y).
        basis: (s, f) values of the surface's basis functions at the detections; f may be 0.
        surface_mm: (f,) coefficients of the surface.
    """
    height = basis @ surface_mm if basis.shape[1] else np.zeros(len(points.row))
    lean = motion.turned(points.row, points.lean)
    residual = motion.board(points.row, points.ground_mm) + lean * height[:, None] - apply_similarity(c, points.cad)
    parts = [_row_jacobian(motion, points.row, points.ground_mm), -similarity_jacobian(points.cad)]
    if basis.shape[1]:
        parts.append(lean[:, :, None] * basis[:, None, :])
    return residual, np.concatenate(parts, 2)


def detection_equations(points: FiducialPoints, residual: Floats, jacobian: Floats, others: Ints) -> Equations:
    """Return the robustly weighted, whitened equations of s detections.

    Args:
        points: the detections.
        residual: (s, 2) residuals, mm.
        jacobian: (s, 2, 3 + u) their derivatives by the row of each detection and by u other unknowns.
        others: (s, u) columns of the other unknowns of each detection: C, the surface, and the camera.
    """
    sigma = detection_sigma_mm(points)
    chi = np.sqrt((residual**2).sum(1) / 2) / sigma
    many = points.which < 0
    if many.any():
        # While the rows have only their nominal motion, all these points have large residuals without being outliers.
        # The limits are therefore scaled by the median residual.
        scale = max(float(np.median(chi[many])), 1.0)
        chi, sigma = np.where(many, chi / scale, chi), np.where(many, sigma * scale, sigma)
    robust = np.where(many & (chi > _CUT), 0.0, huber_weights(chi, _KNEE))
    weight = (np.sqrt(robust) / sigma)[:, None]
    columns = np.concatenate([3 * points.row[:, None] + np.arange(3), others], 1)
    return columns, weight[:, :, None] * jacobian, weight * residual


def scale_equation(c: Floats, nominal_scale: float, columns: Ints) -> Equations:
    """Return the prior equation that the scale of the similarity c = (a, b, x, y) is close to its nominal value.

    `columns` (2,) are the columns of the unknowns a and b.
    """
    scale = float(np.hypot(*c[:2]))
    sigma = _SCALE_SIGMA * nominal_scale
    gradient = c[None, None, :2] / scale / sigma
    return columns[None], gradient, np.array([[(scale - nominal_scale) / sigma]])


def detection_sigma_mm(points: FiducialPoints) -> Floats:
    """Return the standard deviation (s,) of each detection, mm.

    If a fiducial has n detections, the variance of their common error is multiplied by n in each. The mean of the
    detections then has at least the variance of the common error.
    """
    own = points.sigma_mm**2 + (_SINGLE_PX / points.px_per_mm) ** 2
    shared = (_COMMON_PX / points.px_per_mm) ** 2
    fiducial = points.which >= 0
    count = np.bincount(points.which[fiducial], minlength=1)
    times = np.where(fiducial, count[np.maximum(points.which, 0)], 1)
    return np.asarray(np.sqrt(own + times * shared))


def _row_jacobian(motion: Motion, row: Ints, ground_mm: Floats) -> Floats:
    """Return the derivatives (k, 2, 3) of `motion.board` at ground points (k, 2) by (φ, sx, sy) of their rows (k,)."""
    arm = motion.turned(row, ground_mm - motion.pivot)
    one, nil = np.ones(len(arm)), np.zeros(len(arm))
    return np.stack([np.stack([-arm[:, 1], one, nil], -1), np.stack([arm[:, 0], nil, one], -1)], 1)
