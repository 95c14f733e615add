"""Equations of the fiducials: their detections, and the scale on which CAD data and calibration agree."""

from __future__ import annotations

import numpy as np

from vaoi_station.geometry.robust import huber_weights
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.observations import Ints
from vaoi_station.stitching.adjustment.problem import FiducialPoints
from vaoi_station.stitching.adjustment.similarity import apply_similarity, similarity_jacobian

_SINGLE_PX, _COMMON_PX = 0.002, 0.004
"""Errors of a detection beyond its own standard deviation: one of its own, and one that all detections of the same
fiducial have in common (artwork, light) and that does not average out (docs/measured/uncertainty.md)."""
_SCALE_SIGMA = 3e-4
"""Shrinkage or stretch of a board against its CAD data (1 σ, relative)."""
_KNEE, _CUT = 2.0, 6.0
"""Standard deviations beyond which a detection loses weight (Huber), and beyond which a point of many has none."""

Equations = tuple[Ints, Floats, Floats]
"""Columns (k, f) of the unknowns, and whitened a (k, r, f) and b (k, r): a·δ + b ≈ 0."""


def fiducial_residuals(
    points: FiducialPoints, motion: Motion, c: Floats, basis: Floats, surface_mm: Floats
) -> tuple[Floats, Floats]:
    """Return residuals (s, 2) in mm and their Jacobian (s, 2, 3 + 4 + f) by row, C and surface.

    Args:
        points: the detections.
        motion: of the rows.
        c: the similarity (a, b, x, y).
        basis: (s, f) values of the surface's basis functions; f may be 0.
        surface_mm: (f,) coefficients.
    """
    height = basis @ surface_mm if basis.shape[1] else np.zeros(len(points.row))
    lean = motion.turned(points.row, points.lean)
    residual = motion.board(points.row, points.ground_mm) + lean * height[:, None] - apply_similarity(c, points.cad)
    parts = [_row_jacobian(motion, points.row, points.ground_mm), -similarity_jacobian(points.cad)]
    if basis.shape[1]:
        parts.append(lean[:, :, None] * basis[:, None, :])
    return residual, np.concatenate(parts, 2)


def detection_equations(points: FiducialPoints, residual: Floats, jacobian: Floats, others: Ints) -> Equations:
    """Return robustly weighted equations of all detections.

    Args:
        points: the detections.
        residual: (s, 2) mm.
        jacobian: (s, 2, 3 + u) by the row of each detection and the unknowns that stand last.
        others: (u,) columns of the latter.
    """
    sigma = detection_sigma_mm(points)
    chi = np.sqrt((residual**2).sum(1) / 2) / sigma
    many = points.which < 0
    if many.any():
        # while the rows still have their nominal motion all of these points are far off, and none is an outlier yet
        scale = max(float(np.median(chi[many])), 1.0)
        chi, sigma = np.where(many, chi / scale, chi), np.where(many, sigma * scale, sigma)
    robust = np.where(many & (chi > _CUT), 0.0, huber_weights(chi, _KNEE))
    weight = (np.sqrt(robust) / sigma)[:, None]
    columns = np.concatenate(
        [3 * points.row[:, None] + np.arange(3), np.broadcast_to(others, (len(points.row), len(others)))], 1
    )
    return columns, weight[:, :, None] * jacobian, weight * residual


def scale_equation(c: Floats, nominal_scale: float, columns: Ints) -> Equations:
    """Return the prior of the scale: a board is hardly shrunk or stretched. `columns` (2,) are those of a and b."""
    scale = float(np.hypot(*c[:2]))
    sigma = _SCALE_SIGMA * nominal_scale
    gradient = c[None, None, :2] / scale / sigma
    return columns[None], gradient, np.array([[(scale - nominal_scale) / sigma]])


def detection_sigma_mm(points: FiducialPoints) -> Floats:
    """Return the standard deviation (s,) of each detection.

    The error that the n detections of a fiducial share counts n times in each: their mean is never better than it.
    """
    own = points.sigma_mm**2 + (_SINGLE_PX / points.px_per_mm) ** 2
    shared = (_COMMON_PX / points.px_per_mm) ** 2
    fiducial = points.which >= 0
    count = np.bincount(points.which[fiducial], minlength=1)
    times = np.where(fiducial, count[np.maximum(points.which, 0)], 1)
    return np.asarray(np.sqrt(own + times * shared))


def _row_jacobian(motion: Motion, row: Ints, ground_mm: Floats) -> Floats:
    """Return the derivative (k, 2, 3) of a board point by (φ, sx, sy) of its row."""
    arm = motion.turned(row, ground_mm - motion.pivot)
    one, nil = np.ones(len(arm)), np.zeros(len(arm))
    return np.stack([np.stack([-arm[:, 1], one, nil], -1), np.stack([arm[:, 0], nil, one], -1)], 1)
