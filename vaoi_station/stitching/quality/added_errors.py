"""Errors that the covariance of the adjustment does not contain, added to the prediction.

The CAD coordinates of all links to a reference come from the reference's own CAD mapping. So they all have the error of
that mapping. No residual shows this error, and it does not average out. Its effect on the result is proportional to the
weight of the reference in the estimate of C. Components that local
fiducials or those of a board of a panel place have the errors of these.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
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
    camera = predicted.seen_in[:, 0]
    added = np.zeros(int(camera.max(initial=0)) + 1)
    for i, px in sigma_px.items():
        if i < len(added):
            added[i] = px
    return _with_added(predicted, added[camera])


def with_component_errors(
    predicted: PredictedSigma, sigma_mm: Mapping[str, float], cameras: Sequence[Camera], skipped: Collection[str] = ()
) -> PredictedSigma:
    """Return a prediction with an additional error for each component, mm per axis, by address; none without an entry.

    These are the errors of fiducials that place a component, or the board of a panel on which it is. The largest
    standard deviations of rows and run do not contain those of `skipped` components.
    """
    if predicted.worst_px is None or not sigma_mm:
        return predicted
    camera = predicted.seen_in[:, 0]
    px_per_mm = np.array([c.px_per_mm for c in cameras])[camera]
    added = np.array([sigma_mm.get(name, 0.0) for name in predicted.names])[predicted.part] * px_per_mm
    demanded = np.array([name not in skipped for name in predicted.names], np.bool_)[predicted.part]
    return _with_added(predicted, added, demanded)


def _with_added(
    predicted: PredictedSigma, sigma_px: Floats, demanded: NDArray[np.bool_] | bool = True
) -> PredictedSigma:
    """Return a prediction with an additional error (k,) of each of k views, px per axis.

    The largest standard deviations contain those of the `demanded` views (k,) only.
    """
    covariance = predicted.covariance_px2 + (sigma_px**2)[:, None, None] * np.eye(2)
    length, rows = np.where(demanded, largest_sigma(covariance), 0.0), np.array(predicted.rows_px)
    np.maximum.at(rows, predicted.seen_in[:, 1], length)
    worst = max(float(length.max(initial=0)), predicted.worst_px or 0.0)
    return replace(predicted, rows_px=tuple(rows.tolist()), worst_px=worst, covariance_px2=covariance)
