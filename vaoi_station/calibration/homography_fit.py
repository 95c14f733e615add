"""Least-squares fit of N_i and the lens to at least four marks; equation 10.

A normalised direct linear transform gives the initial value. Gauss-Newton steps on pixel residuals give the fit and its
covariance. The prior knowledge about cameras (`camera_prior`) takes part as additional measurements. So stretch,
perspective and distortion stay near 0 where the marks do not determine them, with the standard deviation of the prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vaoi_station.calibration.camera_prior import (
    HIGHER_ORDER,
    SHAPE,
    CameraPrior,
    shape_of_view,
    to_basis,
)
from vaoi_station.geometry.camera_error import basis_fields
from vaoi_station.geometry.lens import Lens
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats, apply

MARK_SIGMA_PX = 0.007
"""Prior standard deviation of a mark's measured position, per axis; it is combined with the residuals of a fit."""
_PRIOR_FREEDOM = 4.0
"""Weight of the prior standard deviation of a mark's position, in degrees of freedom."""
CORRELATED_MARKS = 48.0
"""Errors of marks are correlated (print, sampling, lens model): more marks than this hardly improve the fit."""
_MAX_STEPS = 12
_SIGNIFICANT = 12.0
"""A second coefficient is significant if it lowers the sum of squares by this number of variances: about 3.5 σ."""
_MIN_MARKS, _SECOND_FROM = 4, 16
"""Least number of marks for N_i, and for a second coefficient of distortion."""
_DEGENERATE = 1e-3
_SINGULAR = 1e-8
"""Smallest ratio of the smallest singular value to the largest. Below it, equation 10 has no unique solution."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A camera's N_i (`matrix`, N_33 = 1) and its lens, with residuals and covariance."""

    matrix: Floats
    lens: Lens
    residuals_px: Floats
    """(k, 2) measured minus predicted positions of the marks, in undistorted pixels."""
    covariance: Floats
    """Covariance of n11 n12 n13 n21 n22 n23 n31 n32 and the radial coefficients."""
    sigma_px: float
    """Standard deviation of the measured position of a mark, per axis, px."""
    freedom: float
    """Degrees of freedom: number of measurements minus the number of parameters that the marks determine."""
    field_covariance_px2: Floats
    """Covariance (9, 9) of the error over the frame; see `geometry.camera_error`."""
    prior: CameraPrior

    @property
    def rms_px(self) -> float:
        """Root mean square distance of the measured marks from their predicted positions, px."""
        return float(np.sqrt((self.residuals_px**2).sum(1).mean()))

    @property
    def lens_px(self) -> tuple[float, float]:
        """Displacement at the frame's corner by the first radial coefficient, and its standard deviation, px."""
        return self.lens.radial[0] * self.lens.radius_px, float(np.sqrt(self.covariance[8, 8])) * self.lens.radius_px

    def sigma_at_px(self, raw_px: Floats) -> Floats:
        """Compute the standard deviation (k,) of projected points at raw pixels (k, 2), as a length in px."""
        basis = basis_fields((self.lens.undistort(raw_px) - self.prior.center_px) / self.prior.radius_px)
        return np.asarray(np.sqrt(np.einsum("kip,pq,kiq->k", basis, self.field_covariance_px2, basis)))


def fit_camera(marks_mm: Floats, px: Floats, prior: CameraPrior) -> Fit | Failure:
    """Fit N_i and the radial distortion: one coefficient with its prior, and a second one if it is significant.

    The centre of the prior is the principal point, its radius the R of the polynomial.
    """
    if len(marks_mm) < _MIN_MARKS:
        return Failure(f"{len(marks_mm)} marks do not determine the eight parameters of N; {_MIN_MARKS} are needed")
    if (collinear := _find_collinearity(marks_mm)) is not None:
        return collinear
    fit = _adjust(marks_mm, px, prior, 1)
    if isinstance(fit, Failure) or len(marks_mm) < _SECOND_FROM:
        return fit
    # With more coefficients, a fit may fail although the simpler one succeeds.
    more = _adjust(marks_mm, px, prior, 2)
    if isinstance(more, Failure):
        return fit
    gain = float((fit.residuals_px**2).sum() - (more.residuals_px**2).sum())
    return more if gain > _SIGNIFICANT * more.sigma_px**2 else fit


def estimate_homography(target: Floats, source: Floats) -> Floats | None:
    """Compute the homography (3, 3) with target ~ H·source for (k, 2) points each; None if degenerate.

    Normalised direct linear transform (Hartley).
    """
    # Without normalisation the design matrix mixes px², mm·px and 1, and its null space loses half the digits.
    to_source, to_target = _normalizer(source), _normalizer(target)
    p, q = apply(to_source, source), apply(to_target, target)
    one, nil = np.ones(len(p)), np.zeros((len(p), 3))
    s = np.column_stack([p, one])
    design = np.vstack([np.hstack([s, nil, -q[:, :1] * s]), np.hstack([nil, s, -q[:, 1:] * s])])
    _, singular, vt = np.linalg.svd(design)
    # For a unique solution the null space has dimension one: the eighth singular value must not vanish.
    if singular[7] < _DEGENERATE * singular[0]:
        return None
    h = np.linalg.inv(to_target) @ vt[8].reshape(3, 3) @ to_source
    return np.asarray(h / h[2, 2])


def _find_collinearity(marks_mm: Floats) -> Failure | None:
    """Return a failure if all marks, or all except one, lie on one line. Such marks do not determine N_i."""
    offsets = marks_mm - marks_mm.mean(0)
    spread = np.linalg.svd(offsets, compute_uv=False) / np.sqrt(len(offsets))
    if spread[1] < 0.02 * spread[0]:
        return Failure(
            f"its {len(marks_mm)} marks are collinear: they lie within {spread[1]:.2f} mm (rms) of one line "
            f"of {spread[0]:.1f} mm (rms)"
        )
    if estimate_homography(marks_mm, marks_mm) is None:
        return Failure(f"all but one of its {len(marks_mm)} marks are collinear, which determines no plane")
    return None


def _adjust(marks_mm: Floats, px: Floats, prior: CameraPrior, order: int) -> Fit | Failure:
    """Estimate the eight entries of N (with normalised source) and `order` coefficients of the lens by Gauss-Newton."""
    normal_from_mm = _normalizer(marks_mm)
    p = apply(normal_from_mm, marks_mm)
    lens = Lens(prior.center_px, prior.radius_px, (0.0,) * order)
    h = estimate_homography(px, p)
    if h is None:
        return Failure(f"its {len(p)} marks are at one position in the frame, which determines no view of a plane")
    # The prior is so weak that the weight of the marks matters little: two rounds are enough.
    sigma = least = float(np.hypot(MARK_SIGMA_PX, prior.print_px))
    correlation = 1 + len(p) / CORRELATED_MARKS
    for _ in range(2):
        weight = 1 / (sigma * np.sqrt(correlation))
        h, lens = _solve(p, px, prior, h, lens, weight)
        residual = lens.undistort(px) - apply(h, p)
        design = _design(h, lens, p, px).reshape(len(p) * 2, -1)
        scale = np.sqrt((design**2).sum(0))
        singular = np.linalg.svd(design[:, :8] / scale[:8], compute_uv=False)
        if not singular[-1] > _SINGULAR * singular[0]:
            return Failure(f"its {len(p)} marks determine no view of a plane: some are assigned wrongly")
        known = _prior_equations(prior, h, lens)[1]
        data = (design * weight).T @ (design * weight)
        covariance = np.linalg.inv((data + known.T @ known) / np.outer(scale, scale)) / np.outer(scale, scale)
        freedom = max(2 * len(p) - float(np.trace(covariance @ data)), 0.0)
        # A few marks leave few residuals, which may be small by chance. The prior keeps the variance from being too
        # small.
        total = float((residual**2).sum()) + _PRIOR_FREEDOM * least**2
        sigma = float(np.sqrt(max(total / (freedom + _PRIOR_FREEDOM), prior.print_px**2)))
    matrix, jacobian = _denormalize(h, normal_from_mm, order)
    field = _field_covariance(px, prior, h, lens, covariance @ (design * weight**2).T, covariance)
    return Fit(matrix, lens, residual, jacobian @ covariance @ jacobian.T, sigma, freedom, field, prior)


def _solve(p: Floats, px: Floats, prior: CameraPrior, h: Floats, lens: Lens, weight: float) -> tuple[Floats, Lens]:
    """Iterate the adjustment of H (p → undistorted px) and of the lens until it converges."""
    for _ in range(_MAX_STEPS):
        residual = lens.undistort(px) - apply(h, p)
        design = _design(h, lens, p, px).reshape(len(p) * 2, -1)
        prior_residual, prior_design = _prior_equations(prior, h, lens)
        rows = np.vstack([design * weight, prior_design])
        # The columns are scaled to length 1, because entries of N and coefficients of the lens differ by orders of
        # magnitude.
        scale = np.sqrt((rows**2).sum(0))
        step = (
            np.linalg.lstsq(rows / scale, np.append(residual.ravel() * weight, prior_residual), rcond=None)[0] / scale
        )
        h = h + np.append(step[:8], 0).reshape(3, 3)
        lens = replace(lens, radial=tuple(float(a + d) for a, d in zip(lens.radial, step[8:], strict=True)))
        if np.abs(step * scale).max() / weight < 1e-9:
            break
    return h, lens


def _design(h: Floats, lens: Lens, p: Floats, px: Floats) -> Floats:
    """Compute the derivative (k, 2, 8 + q) of projected minus undistorted px by 8 entries of N_i and q of the lens."""
    return np.concatenate([_homography_jacobian(h, p), -_lens_jacobian(lens, px)], axis=2)


def _prior_equations(prior: CameraPrior, h: Floats, lens: Lens) -> tuple[Floats, Floats]:
    """Return residuals (m,) and design (m, 8 + q) of stretch, perspective and distortion of 0, in their sigmas."""
    order = len(lens.radial)
    sigma = prior.sigma_px(order)
    image = prior.grid_px
    by_h = to_basis(_homography_jacobian(h, apply(np.linalg.inv(h), image)))
    design = np.zeros((4 + order, 8 + order))
    design[:4, :8] = by_h[SHAPE]
    design[4:, 8:] = np.eye(order) * lens.radius_px
    value = np.append(shape_of_view(prior, h), np.array(lens.radial) * lens.radius_px)
    return -value / sigma, design / sigma[:, None]


def _field_covariance(
    px: Floats, prior: CameraPrior, h: Floats, lens: Lens, gain: Floats, covariance: Floats
) -> Floats:
    """Return the covariance (9, 9) of the error over the frame; `gain` (8 + q, 2k) is parameters by residuals."""
    image = prior.grid_px
    over_frame = to_basis(_design(h, lens, apply(np.linalg.inv(h), image), image))
    out = over_frame @ covariance @ over_frame.T + prior.flatness_covariance_px2()
    if len(lens.radial) > 1:
        return np.asarray(out)
    # A part of the distortion is not described by the first coefficient. Where there are marks, the fit absorbs this
    # part. Elsewhere it remains as an error.
    second = Lens(lens.center_px, lens.radius_px, (0.0, 0.0))
    amount = HIGHER_ORDER * lens.radial[0] * lens.radius_px
    taken = gain @ _lens_jacobian(second, px)[..., 1].ravel() / lens.radius_px
    left = to_basis(_lens_jacobian(second, image)[..., 1:] / lens.radius_px)[:, 0] - over_frame @ taken
    out += amount**2 * np.outer(left, left)
    return np.asarray((out + out.T) / 2)


def _denormalize(h: Floats, normal_from_mm: Floats, order: int) -> tuple[Floats, Floats]:
    """Return N = H·T with N_33 = 1, and the Jacobian of all parameters by those of the normalised fit."""
    full = h @ normal_from_mm
    n = full / full[2, 2]
    # d vec(H·T) / d vec(H), row-major.
    spread = np.kron(np.eye(3), normal_from_mm.T)[:, :8]
    by_h = (spread - np.outer(n.ravel(), spread[8])) / full[2, 2]
    jacobian = np.eye(8 + order)
    jacobian[:8, :8] = by_h[:8]
    return n, jacobian


def _homography_jacobian(h: Floats, p: Floats) -> Floats:
    """Compute the derivative (k, 2, 8) of H·p by the first eight entries of H."""
    w = p @ h[2, :2] + h[2, 2]
    q = apply(h, p)
    s, nil = np.column_stack([p, np.ones(len(p))]) / w[:, None], np.zeros((len(p), 3))
    x = np.hstack([s, nil, -q[:, :1] * s[:, :2]])
    y = np.hstack([nil, s, -q[:, 1:] * s[:, :2]])
    return np.stack([x, y], axis=1)


def _lens_jacobian(lens: Lens, raw_px: Floats) -> Floats:
    """Compute the derivative (k, 2, q) of undistorted pixels (k, 2) by the q radial coefficients."""
    offset = raw_px - lens.center_px
    rho2 = (offset**2).sum(1) / lens.radius_px**2
    columns = [offset * (rho2 ** (k + 1))[:, None] for k in range(len(lens.radial))]
    return np.stack(columns, axis=2) if columns else np.zeros((len(raw_px), 2, 0))


def _normalizer(points: Floats) -> Floats:
    """Return the similarity (3, 3) that maps points to a mean of 0 and a mean distance of √2 from the origin."""
    middle = points.mean(0)
    size = float(np.hypot(*(points - middle).T).mean()) / np.sqrt(2)
    k = 1 / max(size, 1e-12)
    return np.array([[k, 0, -k * middle[0]], [0, k, -k * middle[1]], [0, 0, 1.0]])
