"""The error that a reference adds to the result of a run placed against it.

The CAD coordinates of all links to a reference come from the reference's own CAD mapping. So they all have the error of
that mapping. No residual shows this error, and it does not average out. Its effect on the result is proportional to the
weight of the reference in the estimate of C.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.problem import REFERENCE, FiducialPoints
from vaoi_station.stitching.board.reference import inliers
from vaoi_station.stitching.quality.covariances import largest_sigma
from vaoi_station.stitching.quality.uncertainty import PredictedSigma


def reference_share(points: FiducialPoints | None, residual_px: Floats) -> float:
    """Return which share (0 to 1) of the information about C comes from the reference.

    Args:
        points: the k points with known CAD coordinates.
        residual_px: (k, 2) their residuals in the adjustment.
    """
    if points is None or not len(points.which):
        return 0.0
    sigma_px = points.sigma_mm * points.px_per_mm
    weight = np.where(inliers(points, residual_px), sigma_px**-2.0, 0.0)
    whole = float(weight.sum())
    return float(weight[points.which == REFERENCE].sum()) / whole if whole > 0 else 0.0


def with_common_error(predicted: PredictedSigma, sigma_px: float) -> PredictedSigma:
    """Return a prediction with an additional error that all component positions have in common, px per axis."""
    if predicted.worst_px is None:
        return predicted
    return replace(
        predicted,
        rows_px=tuple(float(np.hypot(v, sigma_px)) for v in predicted.rows_px),
        worst_px=float(np.hypot(predicted.worst_px, sigma_px)),
        covariance_px2=predicted.covariance_px2 + sigma_px**2 * np.eye(2),
    )


def with_camera_errors(predicted: PredictedSigma, sigma_px: Mapping[int, float]) -> PredictedSigma:
    """Return a prediction with an additional error for each camera, px per axis; none for cameras without an entry."""
    if predicted.worst_px is None or not any(sigma_px.values()):
        return predicted
    camera, row = predicted.seen_in.T
    added = np.zeros(int(camera.max(initial=0)) + 1)
    for i, px in sigma_px.items():
        if i < len(added):
            added[i] = px
    covariance = predicted.covariance_px2 + (added[camera] ** 2)[:, None, None] * np.eye(2)
    length, rows = largest_sigma(covariance), np.array(predicted.rows_px)
    np.maximum.at(rows, row, length)
    worst = max(float(length.max(initial=0)), predicted.worst_px)
    return replace(predicted, rows_px=tuple(rows.tolist()), worst_px=worst, covariance_px2=covariance)
