"""Predicted uncertainty of positions: the covariance of the adjustment, carried over to the images.

The covariance of a component's position is that of the residual that an exact detection of it would have. Errors that
the adjustment does not contain are added: of the calibrated shape of pictures, of the CAD mapping of a reference, of
local fiducials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from vaoi_station.frame_index import FootprintViews
from vaoi_station.geometry import Camera
from vaoi_station.geometry.camera_error import basis_px
from vaoi_station.geometry.displacement import PARAMETERS, CameraMatrices
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.cameras import CameraEffects
from vaoi_station.stitching.adjustment.problem import REFERENCE, AdjustmentResult, FiducialPoints, Ints, basis
from vaoi_station.stitching.board.board_plane import BoardPlane, landmarks
from vaoi_station.stitching.board.reference import inliers
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.frames import Scene

MODEL_PX = 0.002
"""Standard deviation of errors that no residual shows: errors of calibration, artwork and flatness."""
_MARK_SIGMAS = 2.0
"""Changes without one of the few marks that place a board are explained up to this number of standard deviations."""
_LEAST_MM2 = 1e-12
"""Least variance by the model along an axis: a thousandth of a px at 1000 px/mm."""
_DIGITS = 4


@dataclass(frozen=True, eq=False)
class PredictedSigma:
    """The covariance of each view of a component, and the largest standard deviations, each in its worst direction."""

    rows_px: tuple[float, ...]
    """For each row, the largest of a component in view. Without components, that of the row's motion."""
    worst_px: float | None
    """The largest over all views of components; None without C."""
    names: tuple[str, ...]
    part: Ints
    """(k,) number of the component that each view shows. Views are ordered by component, then camera, then row."""
    seen_in: Ints
    """(k, 2) camera and row of the frame of each view."""
    covariance_px2: Floats
    """(k, 2, 2) covariance of image x and y in each view."""

    @cached_property
    def views(self) -> dict[str, dict[FrameKey, Floats]]:
        """Covariances (2, 2) px² of all views, by address and frame."""
        out: dict[str, dict[FrameKey, Floats]] = {}
        for n, (i, j), c in zip(self.part.tolist(), self.seen_in.tolist(), self.covariance_px2, strict=True):
            out.setdefault(self.names[n], {})[i, j] = c
        return out

    @cached_property
    def length_px(self) -> Floats:
        """(k,) largest standard deviation of each view."""
        return largest_sigma(self.covariance_px2)

    @cached_property
    def of_components(self) -> dict[str, float]:
        """The largest standard deviation over the views of each component, by address, rounded to four decimals."""
        worst = np.zeros(len(self.names))
        np.maximum.at(worst, self.part, self.length_px)
        each = zip(self.names, np.round(worst, _DIGITS).tolist(), (worst > 0).tolist(), strict=True)
        return {name: px for name, px, seen in each if seen}

    def with_errors(self, sigma_px: Floats, demanded: NDArray[np.bool_]) -> PredictedSigma:
        """Return a prediction with an additional error (k,) of each view, px per axis."""
        if self.worst_px is None or not sigma_px.any():
            return self
        covariance = self.covariance_px2 + (sigma_px**2)[:, None, None] * np.eye(2)
        length, rows = np.where(demanded, largest_sigma(covariance), 0.0), np.array(self.rows_px)
        np.maximum.at(rows, self.seen_in[:, 1], length)
        worst = max(float(length.max(initial=0)), self.worst_px)
        return replace(self, rows_px=tuple(rows.tolist()), worst_px=worst, covariance_px2=covariance)

    def to_json(self) -> dict[str, list[list[float]]]:
        """Return for each component, by address, a list of its views [camera, row, xx, xy, yy].

        xx, xy and yy are the elements of the covariance, px², rounded to four significant digits.
        """
        values = self.covariance_px2[:, (0, 0, 1), (0, 1, 1)]
        with np.errstate(divide="ignore"):
            digits = _DIGITS - 1 - np.floor(np.log10(np.abs(values)))
        unit = 10.0 ** np.where(np.isfinite(digits), digits, 0)
        views = zip(*self.seen_in.T.tolist(), *(np.round(values * unit) / unit).T.tolist(), strict=True)
        entries = [list(view) for view in views]
        ends = [0, *np.cumsum(np.bincount(self.part, minlength=len(self.names))).tolist()]
        return {name: entries[a:b] for name, (a, b) in zip(self.names, pairwise(ends), strict=True) if b > a}


def predict_sigma(
    scene: Scene, plane: BoardPlane | None, adjusted: AdjustmentResult, views: FootprintViews | None
) -> PredictedSigma:
    """Predict the covariance of components' positions in every good frame that shows them.

    `views` are those of the plane's `landmarks`; None without C.
    """
    cameras, motion = scene.cameras, adjusted.motion
    resolution = float(np.mean([camera.px_per_mm for camera in cameras]))
    of_rows = np.hypot(largest_sigma(adjusted.covariance[:, 1:3, 1:3]) * resolution, MODEL_PX).tolist()
    if plane is None or views is None:
        none = np.zeros(0, dtype=np.int_)
        return PredictedSigma(tuple(of_rows), None, (), none, np.zeros((0, 2), dtype=np.int_), np.zeros((0, 2, 2)))
    whole = np.zeros((len(cameras), len(of_rows)), dtype=np.bool_)
    whole[tuple(np.array(scene.present, dtype=np.int_).reshape(-1, 2).T)] = True
    right, bottom = np.array([(c.width_px - 1, c.height_px - 1) for c in cameras]).T[:, views.camera]
    x, y = views.px.T
    at = np.flatnonzero((x >= 0) & (y >= 0) & (x <= right) & (y <= bottom) & whole[views.camera, views.row])
    part, camera, row = (numbers.take(at) for numbers in (views.point, views.camera, views.row))
    place, (names, cad) = views.place_mm.take(at, axis=0), landmarks(plane)
    *foot, inverse = np.array([c.viewpoint for c in cameras])[camera].T
    lean = (np.array(foot).T - place) * inverse[:, None]
    functions = basis(plane.board_type, cad) if len(adjusted.surface_mm) else np.zeros((len(cad), 0))
    heights = motion.turned(row, lean)[:, :, None] * functions.take(part, axis=0)[:, None]
    j = jacobians(motion.angle[row], place - motion.pivot, plane.flat(cad).take(part, axis=0), heights)
    covariance = _views_covariance(j, adjusted, cameras, camera, row)
    covariance = covariance + _unexplained_influence(j, row, adjusted, covariance)
    px_per_mm = np.array([c.px_per_mm for c in cameras])[camera]
    # The adjustment takes artwork and calibrated camera shapes as exact: their errors are added here.
    covariance = covariance * px_per_mm[:, None, None] ** 2 + MODEL_PX**2 * np.eye(2)
    covariance = covariance + shape_covariances(cameras, camera, views.px.take(at, axis=0))
    rows = np.zeros(len(of_rows))
    np.maximum.at(rows, row, largest_sigma(covariance))
    by_row = tuple(float(v) or w for v, w in zip(rows, of_rows, strict=True))
    worst = float(rows.max(initial=0)) or None
    return PredictedSigma(by_row, worst, names, part, np.column_stack([camera, row]), covariance)


def jacobians(angle: Floats, arm: Floats, flat: Floats, heights: Floats) -> Floats:
    """Return the derivatives (k, 2, 7 + f) of the residuals of exact detections, mm.

    Columns are φ, sx, sy of the row, then a, b, x, y of C, then the f functions of the surface.

    Args:
        angle: (k,) turn of the row of each view, rad.
        arm: (k, 2) ground point less the pivot, mm.
        flat: (k, 2) flat coordinates of the point.
        heights: (k, 2, f) derivatives by the surface.
    """
    (cos, sin), (x, y), (u, v) = (np.cos(angle), np.sin(angle)), arm.T, flat.T
    j = np.zeros((len(angle), 2, 7 + heights.shape[2]))
    j[:, 0, 0], j[:, 1, 0] = -sin * x - cos * y, cos * x - sin * y
    j[:, 0, 1] = j[:, 1, 2] = 1.0
    j[:, 0, 3], j[:, 0, 4], j[:, 1, 3], j[:, 1, 4] = -u, v, -v, -u
    j[:, 0, 5] = j[:, 1, 6] = -1.0
    j[:, :, 7:] = heights
    return j


def _carried(j: Floats, number: Ints, covariance: Floats) -> Floats:
    """Return the covariances (k, 2, 2) of views, from those (c, u, u) of the unknowns with their numbers (k,)."""
    order, many = np.argsort(number, kind="stable"), np.bincount(number)
    present, u = np.flatnonzero(many), j.shape[2]
    together, ends = j.take(order, axis=0).reshape(-1, u), [0, *np.cumsum(2 * many[present]).tolist()]
    half = np.empty_like(together)
    for n, first, end in zip(present.tolist(), ends, ends[1:], strict=False):
        np.matmul(together[first:end], covariance[n], out=half[first:end])
    out = np.empty((2, 2, len(j)))
    for a, b in ((0, 0), (0, 1), (1, 1)):
        out[a, b, order] = np.einsum("ku,ku->k", half[a::2], together[b::2])
    out[1, 0] = out[0, 1]
    return np.ascontiguousarray(np.moveaxis(out, 2, 0))


def _views_covariance(
    j: Floats, adjusted: AdjustmentResult, cameras: Sequence[Camera], camera: Ints, row: Ints
) -> Floats:
    """Return the covariances (k, 2, 2) of views in frames (k,) by the adjustment, displacements of cameras included.

    Those of the unknowns of a row grow by what a displacement of the camera does to the row (`CameraEffects`).
    """
    estimate, motion = adjusted.cameras, adjusted.motion
    if estimate is None:
        return _carried(j, row, adjusted.covariance)
    effects = CameraEffects.of(CameraMatrices.of(cameras), np.zeros_like(estimate.displacement_px))
    n, m, u = len(cameras), *adjusted.covariance.shape[:2]
    moved = np.zeros((n, m, u, PARAMETERS))
    moved[:, :, :3] = effects.row_changes(motion.angle, motion.pivot)
    # (n, m, u, 3) covariance of the unknowns of each row with the displacement of each camera
    cross = estimate.cross.reshape(m, u, n, PARAMETERS).transpose(2, 0, 1, 3)
    own = np.array([estimate.covariance[i : i + PARAMETERS, i : i + PARAMETERS] for i in range(0, 3 * n, PARAMETERS)])
    mixed = (cross + moved @ (own / 2)[:, None]) @ moved.swapaxes(2, 3)
    whole = adjusted.covariance + mixed + mixed.swapaxes(2, 3)
    return _carried(j, camera * m + row, whole.reshape(-1, u, u))


def _unexplained_influence(j: Floats, row: Ints, adjusted: AdjustmentResult, covariance: Floats) -> Floats:
    """Return the covariance (k, 2, 2) mm² of k views that follows from the influence of single places and marks.

    If a view moves further without the links of one place than the noise model explains, these links or the others are
    wrong, and so with marks. What the model does not explain is added up over the places of a grid, and the grid with
    the largest sum counts. One of the marks is wrong, each as probably as the others: the mean over them counts. Both
    count along the axes on which they are larger than the covariance (k, 2, 2) by the model.
    """
    influence = adjusted.influence
    if influence is None or not len(covariance):
        return np.zeros_like(covariance)
    of_grids, of_marks = np.zeros((influence.grids.shape[1], *covariance.shape)), np.zeros_like(covariance)
    for change, growth, grids in zip(influence.change, influence.growth, influence.grids, strict=True):
        explained = growth if grids.any() else _MARK_SIGMAS**2 * growth
        views = _positive(_carried(j, row, change[:, :, None] * change[:, None] - explained), 0.0)
        of_grids[grids] += views
        of_marks += 0.0 if grids.any() else views / influence.marks
    largest = largest_sigma(of_grids).argmax(0)
    total = of_grids[largest, np.arange(len(covariance))] + of_marks
    # In units of the covariance by the model, along whose axes it is 1. Rounding may leave a huge one, of an unobserved
    # unknown, without an inverse: its axes are bounded from below.
    values, axes = np.linalg.eigh(covariance)
    length = np.sqrt(np.maximum(values, _LEAST_MM2))[:, None]
    root, inverse = axes * length, axes / length
    return np.asarray(root @ _positive(inverse.swapaxes(1, 2) @ total @ inverse, 1.0) @ root.swapaxes(1, 2))


def _positive(matrices: Floats, limit: float) -> Floats:
    """Return symmetric matrices (k, 2, 2) without their parts along axes on which they are at most `limit`."""
    a, b, d = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    middle, half = (a + d) / 2, np.hypot((a - d) / 2, b)
    largest, smallest = middle + half, middle - half
    # Of one axis alone: the matrix less the smallest value in all directions is along the axis of the largest one.
    share = np.divide(largest, 2 * half, out=np.zeros_like(half), where=(largest > limit) & (half > 0))
    along = share[:, None, None] * (matrices - smallest[:, None, None] * np.eye(2))
    return np.where((smallest > limit)[:, None, None], matrices, along)


def largest_sigma(covariance: Floats) -> Floats:
    """Compute the largest standard deviation over all directions, (…), for covariances (…, 2, 2)."""
    a, b, d = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    return np.asarray(np.sqrt(np.maximum((a + d) / 2 + np.hypot((a - d) / 2, b), 0)))


def reference_share(points: FiducialPoints, residual_px: Floats) -> float:
    """Return which share (0 to 1) of the information about C comes from the reference."""
    weight = np.where(inliers(points, residual_px), (points.sigma_mm * points.px_per_mm) ** -2.0, 0.0)
    whole = float(weight.sum())
    return float(weight[points.which == REFERENCE].sum()) / whole if whole > 0 else 0.0


def shape_covariances(cameras: Sequence[Camera], camera: Ints, raw_px: Floats) -> Floats:
    """Compute the covariance (k, 2, 2) px² of k raw pixels (k, 2), of cameras (k,), by errors of the calibrated shape.

    These are scale, stretch, perspective and radial distortion; displacements are unknowns of the adjustment, estimated
    at the seams, so that an error of the shape there shifts the whole picture. 0 where no covariance is known.
    """
    out = np.zeros((len(raw_px), 2, 2))
    for i in np.flatnonzero([own.covariance_px2 is not None for own in cameras]).tolist():
        mine = camera == i
        own = _by_shape(cameras[i], cameras[i].lens.undistort(raw_px[mine]))
        # At a seam, the shape errors of both cameras count.
        out[mine] = own + 2 * _at_seams(cameras[i])
    return out


def _by_shape(camera: Camera, px: Floats) -> Floats:
    """Return the covariance (k, 2, 2) px² of undistorted pixels (k, 2) by the six shape terms of a calibration."""
    if camera.covariance_px2 is None:
        return np.zeros((len(px), 2, 2))
    j = basis_px(camera, px)[:, :, PARAMETERS:]
    return np.asarray(j @ np.asarray(camera.covariance_px2)[PARAMETERS:, PARAMETERS:] @ j.swapaxes(1, 2))


def _at_seams(camera: Camera) -> Floats:
    """Return the mean covariance (2, 2) px² of a camera's shape errors at the middles of its picture's four sides."""
    x, y = camera.center_px
    return np.asarray(_by_shape(camera, np.array([(0.0, y), (2 * x, y), (x, 0.0), (x, 2 * y)])).mean(0))


def seam_sigma_px(camera: Camera) -> float:
    """Return the standard deviation (px) of a camera's shape errors at its seams, worst direction; 0 if unknown."""
    return float(largest_sigma(_at_seams(camera)))


def row_covariances(adjusted: AdjustmentResult) -> Floats:
    """Compute the covariance of (φ, x, y) at the pivot for each of the m matrices D_j: (m, 3, 3), rad and mm."""
    c, s = np.cos(adjusted.motion.angle), np.sin(adjusted.motion.angle)
    # The adjustment uses the inverse of D_j, board = R(φ)·(x − c) + c + s. An error δs of this shift moves the ground
    # point by −R(−φ)·δs, and an error of the turn has the opposite sign.
    turn = np.zeros((len(c), 3, 3))
    turn[:, 0, 0] = -1
    turn[:, 1, 1], turn[:, 1, 2], turn[:, 2, 1], turn[:, 2, 2] = -c, -s, s, -c
    return np.asarray(turn @ adjusted.covariance[:, :3, :3] @ turn.swapaxes(1, 2))


def matrix_sigmas(cameras: Sequence[Camera], pivot_mm: Floats, rows: Floats) -> Floats:
    """Compute the standard deviations (n, m, 2) px of the matrices M_ij, at the frame's centre and its worst corner."""
    out = []
    for camera in cameras:
        w, h = camera.width_px - 1.0, camera.height_px - 1.0
        ground = camera.ground(np.array([camera.center_px, (0, 0), (w, 0), (w, h), (0, h)]))
        (x, y), one, none = (ground - pivot_mm).T, np.ones(5), np.zeros(5)
        by_row = np.stack([np.stack([-y, one, none], 1), np.stack([x, none, one], 1)], 1)
        n = camera.image_from_row.matrix
        homogeneous = np.column_stack([ground, one]) @ n.T
        px = homogeneous[:, :2] / homogeneous[:, 2:]
        slope = (n[None, :2, :2] - px[:, :, None] * n[None, 2:, :2]) / homogeneous[:, 2, None, None]
        j = slope @ by_row
        sigma = largest_sigma(j[None] @ rows[:, None] @ j.swapaxes(1, 2)[None])
        out.append(np.stack([sigma[:, 0], sigma[:, 1:].max(1)], -1))
    return np.array(out)


def surface_sigma_mm(plane: BoardPlane, adjusted: AdjustmentResult, cad: Floats) -> Floats:
    """Compute the standard deviation (k,) of the board's height at CAD points (k, 2); 0 without a surface."""
    f = len(adjusted.surface_mm)
    if not f:
        return np.zeros(len(cad))
    b = basis(plane.board_type, cad)
    return np.asarray(np.sqrt(np.einsum("ki,ij,kj->k", b, adjusted.covariance[0, -f:, -f:], b)))
