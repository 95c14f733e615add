"""Errors that the covariance of the adjustment does not contain, added to the prediction.

The CAD coordinates of all links to a reference come from the reference's own CAD mapping. So they all have the error of
that mapping. No residual shows this error, and it does not average out. Its effect on the result is proportional to the
weight of the reference in the estimate of C. Components that local
fiducials or those of a board of a panel place have the errors of these.

Covariances of D_j and standard deviations of M_ij, in the form in which results contain them.

The pivot c is a fixed point of the conveyor's plane in the middle of the array. Three numbers describe the motion of a
row: the turn φ of D_j (rad), and the position (x, y) (mm, row coordinates) of the board point that lies under the pivot
in that row. With errors δφ and δ(x, y), a ground point p has the error δ(x, y) + δφ·(−(p − c)_y, (p − c)_x). The error
of its image point is the derivative of N_i times that. Row 0 has no uncertainty, since D_0 is the identity by
definition.

Predicted uncertainty of component positions: the covariance of the adjustment, carried over to the images.

The position of a component in an image depends on the motion of the row, on C and on the surface. The covariance of the
position is computed as that of the residual that an exact detection of the component would have.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.frame_index import FootprintViews
from vaoi_station.geometry import Camera
from vaoi_station.geometry.camera_error import basis_px
from vaoi_station.geometry.displacement import PARAMETERS
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.cameras import CameraEffects
from vaoi_station.stitching.adjustment.problem import REFERENCE, AdjustmentResult, FiducialPoints, Ints, basis
from vaoi_station.stitching.board.board_plane import BoardPlane, landmarks
from vaoi_station.stitching.board.reference import inliers
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.frames import Scene


def row_covariances(adjusted: AdjustmentResult) -> Floats:
    """Compute the covariance of (φ, x, y) at the pivot for each of the m matrices D_j: (m, 3, 3), rad and mm."""
    motion = adjusted.motion
    m = len(motion.angle)
    c, s = np.cos(motion.angle), np.sin(motion.angle)
    # The adjustment uses the inverse of D_j, board = R(φ)·(x − c) + c + s. An error δs of this shift moves the ground
    # point by −R(−φ)·δs, and an error of the turn has the opposite sign.
    turn = np.zeros((m, 3, 3))
    turn[:, 0, 0] = -1
    turn[:, 1, 1], turn[:, 1, 2], turn[:, 2, 1], turn[:, 2, 2] = -c, -s, s, -c
    return np.asarray(turn @ adjusted.covariance[:, :3, :3] @ turn.swapaxes(1, 2))


def matrix_sigmas(cameras: Sequence[Camera], pivot_mm: Floats, rows: Floats) -> Floats:
    """Compute the standard deviations (n, m, 2) px of the matrices M_ij of n cameras and m rows.

    The two values are the standard deviation at the centre of the frame and that at its worst corner, each in the
    direction where it is largest.

    Args:
        cameras: the n cameras.
        pivot_mm: (2,) the pivot.
        rows: (m, 3, 3) covariances of the rows' motion, from `row_covariances`.
    """
    return np.array([_sigmas(camera, pivot_mm, rows) for camera in cameras])


def largest_sigma(covariance: Floats) -> Floats:
    """Compute the largest standard deviation over all directions, (…), for covariances (…, 2, 2)."""
    # Closed form of the larger eigenvalue of a symmetric 2×2 matrix, for all matrices at once.
    a, b, d = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    return np.asarray(np.sqrt(np.maximum((a + d) / 2 + np.hypot((a - d) / 2, b), 0)))


def _sigmas(camera: Camera, pivot_mm: Floats, rows: Floats) -> Floats:
    w, h = camera.width_px - 1.0, camera.height_px - 1.0
    ground = camera.ground(np.array([camera.center_px, (0, 0), (w, 0), (w, h), (0, h)]))
    arm = ground - pivot_mm
    by_row = np.zeros((5, 2, 3))
    by_row[:, 0, 0], by_row[:, 1, 0] = -arm[:, 1], arm[:, 0]
    by_row[:, 0, 1] = by_row[:, 1, 2] = 1
    j = _slope(camera, ground) @ by_row
    sigma = largest_sigma(j[None] @ rows[:, None] @ j.swapaxes(1, 2)[None])
    return np.stack([sigma[:, 0], sigma[:, 1:].max(1)], -1)


def _slope(camera: Camera, ground_mm: Floats) -> Floats:
    """Compute the derivatives (k, 2, 2) of undistorted pixels by ground points (k, 2), px/mm."""
    n = camera.image_from_row.matrix
    homogeneous = np.column_stack([ground_mm, np.ones(len(ground_mm))]) @ n.T
    px = homogeneous[:, :2] / homogeneous[:, 2:]
    return np.asarray((n[None, :2, :2] - px[:, :, None] * n[None, 2:, :2]) / homogeneous[:, 2, None, None])


MODEL_PX = 0.002
"""Standard deviation of errors that no residual shows: errors of calibration, artwork and flatness."""
_MARK_SIGMAS = 2.0
"""Changes without one mark are explained up to this number of standard deviations. Few marks place a board: without one
of three, changes are large by chance."""
_LEAST_MM2 = 1e-12
"""Least variance by the model along an axis: a thousandth of a px at 1000 px/mm."""
_DIGITS = 4


@dataclass(frozen=True, eq=False)
class PredictedSigma:
    """Predicted uncertainty of a run: the covariance of each view of a component, and the largest standard deviations.

    Each standard deviation is the one in the direction in which it is largest.
    """

    rows_px: tuple[float, ...]
    """For each row, the largest standard deviation of a component in view. Without components, that of the row's
    motion."""
    worst_px: float | None
    """The largest standard deviation over all views of components; None without C."""
    names: tuple[str, ...]
    """Addresses of the components."""
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
    def of_components(self) -> dict[str, float]:
        """The largest standard deviation over the views of each component, by address, rounded to four decimals."""
        worst = np.zeros(len(self.names))
        np.maximum.at(worst, self.part, largest_sigma(self.covariance_px2))
        each = zip(self.names, np.round(worst, _DIGITS).tolist(), (worst > 0).tolist(), strict=True)
        return {name: px for name, px, seen in each if seen}

    def with_common_error(self, sigma_px: float) -> PredictedSigma:
        """Return a prediction with an additional error that all component positions have in common, px per axis."""
        if self.worst_px is None or not sigma_px:
            return self
        return replace(
            self,
            rows_px=tuple(float(np.hypot(v, sigma_px)) for v in self.rows_px),
            worst_px=float(np.hypot(self.worst_px, sigma_px)),
            covariance_px2=self.covariance_px2 + sigma_px**2 * np.eye(2),
        )

    def with_errors(self, sigma_px: Floats, demanded: NDArray[np.bool_] | bool = True) -> PredictedSigma:
        """Return a prediction with an additional error (k,) of each view, px per axis.

        The largest standard deviations contain those of the `demanded` views (k,) only.
        """
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
        # All views are rounded in one pass, since a result has thousands.
        with np.errstate(divide="ignore"):
            digits = _DIGITS - 1 - np.floor(np.log10(np.abs(values)))
        unit = 10.0 ** np.where(np.isfinite(digits), digits, 0)
        views = zip(*self.seen_in.T.tolist(), *(np.round(values * unit) / unit).T.tolist(), strict=True)
        entries = [list(view) for view in views]
        ends = [0, *np.cumsum(np.bincount(self.part, minlength=len(self.names))).tolist()]
        return {name: entries[a:b] for name, (a, b) in zip(self.names, pairwise(ends), strict=True) if b > a}


def reference_share(points: FiducialPoints | None, residual_px: Floats) -> float:
    """Return which share (0 to 1) of the information about C comes from the reference.

    The CAD coordinates of all links to a reference come from its own CAD mapping, and have the error of that in common:
    no residual shows it, and it does not average out.

    Args:
        residual_px: (k, 2) their residuals in the adjustment.
    """
    if points is None or not len(points.which):
        return 0.0
    sigma_px = points.sigma_mm * points.px_per_mm
    weight = np.where(inliers(points, residual_px), sigma_px**-2.0, 0.0)
    whole = float(weight.sum())
    return float(weight[points.which == REFERENCE].sum()) / whole if whole > 0 else 0.0


def predict_sigma(
    scene: Scene, plane: BoardPlane | None, adjusted: AdjustmentResult, views: FootprintViews | None
) -> PredictedSigma:
    """Predict the covariance of components' positions in every good frame that shows them.

    Args:
        plane: plane of the board type; None if the board type is unknown.
        views: views of the plane's `landmarks`; None without C.
    """
    resolution = float(np.mean([camera.px_per_mm for camera in scene.cameras]))
    motion = np.hypot(largest_sigma(adjusted.covariance[:, 1:3, 1:3]) * resolution, MODEL_PX).tolist()
    if plane is None or views is None:
        none = np.zeros(0, dtype=np.int_)
        return PredictedSigma(tuple(motion), None, (), none, np.zeros((0, 2), dtype=np.int_), np.zeros((0, 2, 2)))
    names, cad = landmarks(plane)
    whole = np.zeros((len(scene.cameras), len(motion)), dtype=np.bool_)
    whole[tuple(np.array(scene.present, dtype=np.int_).reshape(-1, 2).T)] = True
    last = np.array([(c.width_px - 1, c.height_px - 1) for c in scene.cameras])
    (x, y), (last_x, last_y) = views.px.T, last[views.camera].T
    inside = (x >= 0) & (y >= 0) & (x <= last_x) & (y <= last_y) & whole[views.camera, views.row]
    part, camera, row = (numbers[inside] for numbers in (views.point, views.camera, views.row))
    place = views.place_mm[inside]
    functions = basis(plane.board_type, cad) if len(adjusted.surface_mm) else np.zeros((len(cad), 0))
    seen = ViewArrays(row, part, place, _leans(scene.cameras, camera, place))
    points = PointArrays(plane.flat(cad), functions)
    displacements = _displacements(scene, adjusted, camera, row)
    covariance = position_covariances(seen, points, _row_arrays(adjusted, adjusted.covariance), displacements)
    covariance = covariance + _unexplained_influence(seen, points, adjusted, covariance)
    px_per_mm = np.array([c.px_per_mm for c in scene.cameras])[camera]
    # The adjustment takes artwork and calibrated camera shapes as exact: their errors are added here.
    covariance = covariance * px_per_mm[:, None, None] ** 2 + MODEL_PX**2 * np.eye(2)
    covariance = covariance + shape_covariances(scene.cameras, camera, views.px[inside])
    rows = np.zeros(len(motion))
    np.maximum.at(rows, row, largest_sigma(covariance))
    worst = float(rows.max(initial=0)) or None
    by_row = tuple(float(v) or w for v, w in zip(rows, motion, strict=True))
    return PredictedSigma(by_row, worst, names, part, np.column_stack([camera, row]), covariance)


def _row_arrays(adjusted: AdjustmentResult, covariance: Floats) -> RowArrays:
    return RowArrays(adjusted.motion.angle, adjusted.motion.pivot, covariance)


def _unexplained_influence(
    seen: ViewArrays, points: PointArrays, adjusted: AdjustmentResult, covariance: Floats
) -> Floats:
    """Return the covariance (k, 2, 2) mm² of k views that follows from the influence of single places and marks.

    If a view moves further without the links of one place than the noise model explains, these links or the others are
    wrong, and so with marks. What the model does not explain is added up over the places of a grid, and the grid with
    the largest sum counts. One of the marks is wrong, each as probably as the others: the mean over them counts. Both
    count along the axes on which they are larger than the covariance (k, 2, 2) by the model.
    """
    influence = adjusted.influence
    if influence is None or not len(covariance):
        return np.zeros_like(covariance)
    exact = _exact_cameras(adjusted, np.zeros(len(covariance), dtype=np.int_))
    of_grids, of_marks = np.zeros((influence.grids.shape[1], *covariance.shape)), np.zeros_like(covariance)
    for change, growth, grids in zip(influence.change, influence.growth, influence.grids, strict=True):
        explained = growth if grids.any() else _MARK_SIGMAS**2 * growth
        beyond = change[:, :, None] * change[:, None] - explained
        views = _positive(position_covariances(seen, points, _row_arrays(adjusted, beyond), exact), 0.0)
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
    values, axes = np.linalg.eigh(matrices)
    return np.asarray((axes * np.where(values > limit, values, 0.0)[:, None]) @ axes.swapaxes(1, 2))


def _exact_cameras(adjusted: AdjustmentResult, camera: Ints) -> DisplacementArrays:
    """Return the displacements of cameras (k,) that are taken as exact."""
    u = adjusted.covariance.shape[1]
    return DisplacementArrays(camera, np.zeros((len(camera), 3, 3)), np.zeros((1, u, 0)), np.zeros((0, 0)))


def _leans(cameras: Sequence[Camera], camera: Ints, place: Floats) -> Floats:
    """Compute the parallax per mm of height (k, 2) at ground points (k, 2), for the cameras numbered `camera` (k,)."""
    lean = np.empty(place.shape)
    for i in np.unique(camera).tolist():
        lean[camera == i] = cameras[i].parallax(place[camera == i])
    return lean


def shape_covariances(cameras: Sequence[Camera], camera: Ints, raw_px: Floats) -> Floats:
    """Compute the covariance (k, 2, 2) px² of k raw pixels (k, 2) that errors of the calibration cause.

    Only errors of the picture's shape count: scale, stretch, perspective and radial distortion. Displacements (shift
    and turn) are unknowns of the adjustment. They are estimated where a camera overlaps with its neighbours. An error
    of the shape there shifts the whole picture, so that error is added. The value is 0 for cameras whose calibration
    states no covariance.

    Args:
        camera: (k,) number of the camera of each pixel.
        raw_px: (k, 2) raw pixels.
    """
    out = np.zeros((len(raw_px), 2, 2))
    for i in np.unique(camera).tolist():
        own = shape_covariance(cameras[i])
        if own is not None:
            mine = camera == i
            here = basis_px(cameras[i], cameras[i].lens.undistort(raw_px[mine]))[:, :, PARAMETERS:]
            # At a seam, the shape errors of both cameras count.
            out[mine] = here @ own @ here.swapaxes(1, 2) + 2 * _at_seams(cameras[i], own)
    return out


def shape_covariance(camera: Camera) -> Floats | None:
    """Return the covariance (6, 6) px² of a camera's six shape terms; None if its calibration states none."""
    if camera.covariance_px2 is None:
        return None
    return np.asarray(camera.covariance_px2, dtype=np.float64)[PARAMETERS:, PARAMETERS:]


def uncertain_calibration(cameras: Sequence[Camera], limit_px: float) -> str:
    """Return a clause that names cameras whose calibration has a σ above a limit (px) at the seams; empty if none."""
    sigma = [seam_sigma_px(camera) for camera in cameras]
    unsure = [str(i) for i, px in enumerate(sigma) if px > limit_px]
    if not unsure:
        return ""
    who = f"camera{'s' if len(unsure) > 1 else ''} {', '.join(unsure)}"
    return f"; the calibration of {who} leaves ± {max(sigma):.2f} px at the seams: calibrate with more marks per camera"


def seam_sigma_px(camera: Camera) -> float:
    """Return the standard deviation (px) of a camera's shape errors at its seams, worst direction; 0 if unknown."""
    own = shape_covariance(camera)
    return 0.0 if own is None else float(largest_sigma(_at_seams(camera, own)))


def _at_seams(camera: Camera, shape: Floats) -> Floats:
    """Return the mean covariance (2, 2) px² of a camera's shape errors at the middles of its picture's four sides."""
    x, y = camera.center_px
    sides = basis_px(camera, np.array([(0.0, y), (2 * x, y), (x, 0.0), (x, 2 * y)]))[:, :, PARAMETERS:]
    return np.asarray((sides @ shape @ sides.swapaxes(1, 2)).mean(0))


def _displacements(scene: Scene, adjusted: AdjustmentResult, camera: Ints, row: Ints) -> DisplacementArrays:
    """Collect the uncertainty of the cameras' displacements for k views, of cameras (k,) in rows (k,)."""
    estimate, motion = adjusted.cameras, adjusted.motion
    if estimate is None:
        return _exact_cameras(adjusted, camera)
    effects = CameraEffects.of(scene.cameras, np.zeros_like(estimate.displacement_px))
    by_camera = effects.row_changes(motion.angle, motion.pivot)[camera, row]
    return DisplacementArrays(camera, by_camera, estimate.cross, estimate.covariance)


def surface_sigma_mm(plane: BoardPlane, adjusted: AdjustmentResult, cad: Floats) -> Floats:
    """Compute the standard deviation (k,) of the board's height at CAD points (k, 2); 0 without a surface."""
    f = len(adjusted.surface_mm)
    if not f:
        return np.zeros(len(cad))
    b = basis(plane.board_type, cad)
    return np.asarray(np.sqrt(np.einsum("ki,ij,kj->k", b, adjusted.covariance[0, -f:, -f:], b)))


class ViewArrays(NamedTuple):
    """k views of board points, as arrays for the compiled function."""

    row: Ints
    """(k,) row of each view."""
    point: Ints
    """(k,) number of the point that each view shows."""
    place_mm: Floats
    """(k, 2) position of the point in the conveyor's plane in that row."""
    lean: Floats
    """(k, 2) change of `place_mm` per mm of height."""


class PointArrays(NamedTuple):
    """n points of a board type, as arrays for the compiled function."""

    flat: Floats
    """(n, 2) flat coordinates of the points: CAD coordinates, with y negated if C mirrors."""
    basis: Floats
    """(n, f) values of the surface's basis functions."""


class RowArrays(NamedTuple):
    """The adjusted motion of m rows, with its covariance; f is the number of surface functions."""

    angle: Floats
    """(m,) turn φ of each row, rad."""
    pivot: Floats
    """(2,) pivot about which the turns are counted, mm."""
    covariance: Floats
    """(m, u, u) covariance of the u = 7 + f unknowns: (φ, sx, sy) of the row, (a, b, x, y) of C, and the surface."""


class DisplacementArrays(NamedTuple):
    """The uncertainty of the displacements of n cameras, for k views; the covariances are empty for exact cameras."""

    camera: Ints
    """(k,) camera of each view."""
    by_camera: Floats
    """(k, 3, 3) changes of (φ, sx, sy) of the view's row that have the effect of a displacement of its camera."""
    cross: Floats
    """(m, u, 3n) covariance of the unknowns of `RowArrays.covariance` with the displacements."""
    covariance: Floats
    """(3n, 3n) covariance of the displacements."""


@compiled
def position_covariances(
    views: ViewArrays, points: PointArrays, rows: RowArrays, displacements: DisplacementArrays
) -> Floats:
    """Compute for each view the covariance (k, 2, 2) mm² of the residual of an exact detection of its point."""
    row, point, place, lean = views.row, views.point, views.place_mm, views.lean
    flat, basis = points.flat, points.basis
    angle, pivot, covariance = rows.angle, rows.pivot, rows.covariance
    camera, by_camera, cross, own = (
        displacements.camera,
        displacements.by_camera,
        displacements.cross,
        displacements.covariance,
    )
    movable = len(own) > 0
    f = basis.shape[1]
    u = 7 + f
    j, jc, out = np.zeros((2, u)), np.zeros((2, 3)), np.empty((len(row), 2, 2))
    # Columns of the Jacobian: φ, sx, sy of the row, then a, b, x, y of C, then the surface. The four entries set
    # here are the same for all views.
    j[0, 1] = j[1, 2] = 1.0
    j[0, 5] = j[1, 6] = -1.0
    for k in range(len(row)):
        cos, sin, n = math.cos(angle[row[k]]), math.sin(angle[row[k]]), point[k]
        x, y = place[k, 0] - pivot[0], place[k, 1] - pivot[1]
        j[0, 0], j[1, 0] = -sin * x - cos * y, cos * x - sin * y
        j[0, 3], j[0, 4], j[1, 3], j[1, 4] = -flat[n, 0], flat[n, 1], -flat[n, 1], -flat[n, 0]
        lx, ly = cos * lean[k, 0] - sin * lean[k, 1], sin * lean[k, 0] + cos * lean[k, 1]
        for i in range(f):
            j[0, 7 + i], j[1, 7 + i] = lx * basis[n, i], ly * basis[n, i]
        xx, xy, yy = 0.0, 0.0, 0.0
        for a in range(u):
            wx, wy = 0.0, 0.0
            for b in range(u):
                wx += covariance[row[k], a, b] * j[0, b]
                wy += covariance[row[k], a, b] * j[1, b]
            xx, xy, yy = xx + j[0, a] * wx, xy + j[0, a] * wy, yy + j[1, a] * wy
        if movable:
            first = 3 * camera[k]
            for i in range(2):
                for c in range(3):
                    jc[i, c] = 0.0
                    for x in range(3):
                        jc[i, c] += j[i, x] * by_camera[k, x, c]
            for c in range(3):
                wx, wy = 0.0, 0.0
                for b in range(u):
                    wx += cross[row[k], b, first + c] * j[0, b]
                    wy += cross[row[k], b, first + c] * j[1, b]
                xx, yy = xx + 2 * jc[0, c] * wx, yy + 2 * jc[1, c] * wy
                xy += jc[0, c] * wy + jc[1, c] * wx
                for b in range(3):
                    value = own[first + c, first + b]
                    xx += jc[0, c] * value * jc[0, b]
                    xy += jc[0, c] * value * jc[1, b]
                    yy += jc[1, c] * value * jc[1, b]
        out[k, 0, 0], out[k, 0, 1], out[k, 1, 0], out[k, 1, 1] = xx, xy, xy, yy
    return out
