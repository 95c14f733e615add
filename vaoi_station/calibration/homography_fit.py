"""Least-squares fit of N_i and the lens to at least four marks; equation 10.

A normalised direct linear transform gives the initial value. Gauss-Newton on pixel residuals gives the result and its
covariance. Coefficients of radial distortion are added one by one, as long as they are significant.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vaoi_station.geometry.lens import Lens
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats, apply

MARK_SIGMA_PX = 0.007
"""Prior standard deviation of a mark's position per axis, combined with the residuals of a fit."""
_PRIOR_FREEDOM = 4.0
"""Weight of the prior in degrees of freedom."""
CORRELATED_MARKS = 48.0
"""Errors of marks are correlated (print, sampling, lens model): beyond this number, more marks add little."""
_MAX_STEPS = 12
_SIGNIFICANT = 12.0
"""A coefficient is significant if it lowers the sum of squares by this many variances: about 3.5 sigma."""
_MIN_MARKS = (4, 6, 16)
"""Number of marks required for 0, 1 and 2 coefficients of distortion."""
_DEGENERATE = 1e-3
_SINGULAR = 1e-8
"""Smallest singular value of the adjustment relative to the largest, below which equation 10 has no unique solution."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A camera's N_i (`matrix`, N_33 = 1) and its lens, with residuals and covariance."""

    matrix: Floats
    lens: Lens
    residuals_px: Floats
    """(k, 2) measured minus predicted, in undistorted pixels."""
    covariance: Floats
    """Covariance of n11 n12 n13 n21 n22 n23 n31 n32 and the radial coefficients."""
    sigma_px: float
    """Standard deviation of the measured position of a mark per axis, px."""
    freedom: int
    """Degrees of freedom: measurements minus parameters."""

    @property
    def rms_px(self) -> float:
        """Root mean square length of the residuals."""
        return float(np.sqrt((self.residuals_px**2).sum(1).mean()))

    def sigma_at_px(self, raw_px: Floats) -> Floats:
        """Compute the standard deviation (k,) of projected points at raw pixels (k, 2), as a length in px."""
        undistorted = self.lens.undistort(raw_px)
        ground = apply(np.linalg.inv(self.matrix), undistorted)
        rows = np.concatenate([-_homography_jacobian(self.matrix, ground), _lens_jacobian(self.lens, raw_px)], axis=2)
        return np.asarray(np.sqrt(np.einsum("kip,pq,kiq->k", rows, self.covariance, rows)))


def fit_camera(marks_mm: Floats, px: Floats, center_px: tuple[float, float], radius_px: float) -> Fit | Failure:
    """Fit N_i and the significant coefficients of radial distortion.

    Args:
        marks_mm: (k, 2) tester coordinates, k ≥ 4.
        px: (k, 2) raw pixels.
        center_px: principal point, the centre of the distortion.
        radius_px: R of the distortion polynomial.
    """
    if len(marks_mm) < _MIN_MARKS[0]:
        return Failure(f"{len(marks_mm)} marks do not determine the eight parameters of N; {_MIN_MARKS[0]} are needed")
    if (collinear := _find_collinearity(marks_mm)) is not None:
        return collinear
    best: Fit | None = None
    for order, least in enumerate(_MIN_MARKS):
        if len(marks_mm) < least:
            break
        fit = _adjust(marks_mm, px, Lens(center_px, radius_px, (0.0,) * order))
        # With more coefficients a fit may fail although the simpler one is sound.
        if isinstance(fit, Failure):
            if best is None:
                return fit
            break
        if best is not None and not _is_significant(best, fit):
            break
        best = fit
    assert best is not None
    return best


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


def _adjust(marks_mm: Floats, px: Floats, lens: Lens) -> Fit | Failure:
    """Estimate the eight entries of N (with normalised source) and the coefficients of `lens` by Gauss-Newton."""
    normal_from_mm = _normalizer(marks_mm)
    p, order = apply(normal_from_mm, marks_mm), len(lens.radial)
    h = estimate_homography(px, p)
    if h is None:
        return Failure(f"its {len(p)} marks are at one position in the frame, which determines no view of a plane")
    freedom = 2 * len(p) - 8 - order
    for _ in range(_MAX_STEPS):
        residual = lens.undistort(px) - apply(h, p)
        design = np.concatenate([_homography_jacobian(h, p), -_lens_jacobian(lens, px)], axis=2).reshape(-1, 8 + order)
        # Columns scaled to 1, as entries of N and coefficients of the lens differ by orders of magnitude.
        scale = np.sqrt((design**2).sum(0))
        step = np.linalg.lstsq(design / scale, residual.ravel(), rcond=None)[0] / scale
        h = h + np.append(step[:8], 0).reshape(3, 3)
        lens = replace(lens, radial=tuple(float(a + d) for a, d in zip(lens.radial, step[8:], strict=True)))
        if np.abs(step * scale).max() < 1e-9:
            break
    residual = lens.undistort(px) - apply(h, p)
    # Few marks leave few residuals, which may be small by chance; the prior bounds the variance from below.
    variance = float((residual**2).sum() + _PRIOR_FREEDOM * MARK_SIGMA_PX**2) / (freedom + _PRIOR_FREEDOM)
    scaled = design / scale
    _, singular, vt = np.linalg.svd(scaled, full_matrices=False)
    if not singular[-1] > _SINGULAR * singular[0]:
        return Failure(f"its {len(p)} marks determine no view of a plane: some are assigned wrongly")
    correlation = 1 + len(p) / CORRELATED_MARKS
    covariance = (vt.T / singular**2) @ vt / np.outer(scale, scale) * variance * correlation
    matrix, jacobian = _denormalize(h, normal_from_mm, order)
    return Fit(matrix, lens, residual, jacobian @ covariance @ jacobian.T, float(np.sqrt(variance)), freedom)


def _denormalize(h: Floats, normal_from_mm: Floats, order: int) -> tuple[Floats, Floats]:
    """Convert a fit in normalised coordinates to N = H·T, scaled so that N_33 = 1.

    T is `normal_from_mm`. Also return the Jacobian of all parameters by those of the normalised fit.
    """
    full = h @ normal_from_mm
    n = full / full[2, 2]
    # d vec(H·T) / d vec(H), row-major.
    spread = np.kron(np.eye(3), normal_from_mm.T)[:, :8]
    by_h = (spread - np.outer(n.ravel(), spread[8])) / full[2, 2]
    jacobian = np.eye(8 + order)
    jacobian[:8, :8] = by_h[:8]
    return n, jacobian


def _is_significant(less: Fit, more: Fit) -> bool:
    """Return whether one more lens coefficient reduces the sum of squares more than noise would."""
    gain = float((less.residuals_px**2).sum() - (more.residuals_px**2).sum())
    return gain > _SIGNIFICANT * more.sigma_px**2


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
