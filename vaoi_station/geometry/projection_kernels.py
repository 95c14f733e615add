"""Compiled projection between pixels and points above the belt: lens, N_i and height in one pass.

`lens` is (x0, y0, R, edge, furthest): the centre and the radius in px, and the raw and the undistorted ρ of the turning
point of the polynomial. `radial` holds a1, a2, … and is empty for an ideal lens. `viewpoint` is (x, y, 1 / d): the
foot of the camera in mm and its inverse working distance. The module is imported on first use, because Numba takes a
moment to load.
"""

from __future__ import annotations

import math

import numpy as np

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats

LensShape = tuple[float, float, float, float, float]
_MAX_NEWTON_STEPS = 30
_CONVERGED = 1e-14


@compiled
def ground_to_image(
    place: Floats,
    height: Floats,
    viewpoint: tuple[float, float, float],
    n: Floats,
    radial: Floats,
    lens: LensShape,
    out: Floats,
) -> None:
    """Project points to raw pixels, which are written to `out` (k, 2).

    Args:
        place: points (k, 2), mm in row coordinates.
        height: heights (k,) of the points above the calibrated plane, mm, or one height (1,) for all points.
        viewpoint: foot of the camera and inverse working distance.
        n: N_i (3, 3).
        radial: coefficients of the distortion.
        lens: shape of the distortion.
        out: raw pixels (k, 2).
    """
    x0, y0, inverse = viewpoint
    for i in range(len(place)):
        # The ray from the camera through the raised point meets the calibrated plane further away from the foot.
        share = height[i if len(height) > 1 else 0] * inverse
        x, y = (place[i, 0] - share * x0) / (1 - share), (place[i, 1] - share * y0) / (1 - share)
        w = n[2, 0] * x + n[2, 1] * y + n[2, 2]
        u, v = (n[0, 0] * x + n[0, 1] * y + n[0, 2]) / w, (n[1, 0] * x + n[1, 1] * y + n[1, 2]) / w
        out[i, 0], out[i, 1] = distort_point(u, v, radial, lens)


@compiled
def image_to_ground(
    raw: Floats,
    height: Floats,
    viewpoint: tuple[float, float, float],
    n: Floats,
    radial: Floats,
    lens: LensShape,
    out: Floats,
) -> None:
    """Project raw pixels to points at known heights, which are written to `out` (k, 2).

    Args:
        raw: raw pixels (k, 2).
        height: heights (k,) of the points above the calibrated plane, mm, or one height (1,) for all points.
        viewpoint: (x, y, 1/d): the point of the calibrated plane below the camera, mm, and the inverse of the working
            distance, 1/mm.
        n: inverse of N_i (3, 3).
        radial: coefficients a1, a2, … of the distortion.
        lens: centre, radius and limits of the distortion, as the module describes them.
        out: points (k, 2), mm in row coordinates.
    """
    x0, y0, inverse = viewpoint
    for i in range(len(raw)):
        u, v = undistort_point(raw[i, 0], raw[i, 1], radial, lens)
        w = n[2, 0] * u + n[2, 1] * v + n[2, 2]
        x, y = (n[0, 0] * u + n[0, 1] * v + n[0, 2]) / w, (n[1, 0] * u + n[1, 1] * v + n[1, 2]) / w
        share = height[i if len(height) > 1 else 0] * inverse
        out[i, 0], out[i, 1] = x + (x0 - x) * share, y + (y0 - y) * share


@compiled
def transfer_points(
    raw: Floats,
    ground_from_a: Floats,
    radial_a: Floats,
    lens_a: LensShape,
    shift_mm: Floats,
    b_from_ground: Floats,
    radial_b: Floats,
    lens_b: LensShape,
) -> Floats:
    """Return the raw pixels (k, 2) of camera b that show the same points of the calibrated plane as those of camera a.

    The points move by `shift_mm` (2,) between the exposures of the two cameras. `ground_from_a` is the inverse of N_a,
    and `b_from_ground` is N_b.
    """
    out, m, n = np.empty((len(raw), 2)), ground_from_a, b_from_ground
    for i in range(len(raw)):
        u, v = undistort_point(raw[i, 0], raw[i, 1], radial_a, lens_a)
        w = m[2, 0] * u + m[2, 1] * v + m[2, 2]
        x = (m[0, 0] * u + m[0, 1] * v + m[0, 2]) / w + shift_mm[0]
        y = (m[1, 0] * u + m[1, 1] * v + m[1, 2]) / w + shift_mm[1]
        w = n[2, 0] * x + n[2, 1] * y + n[2, 2]
        u, v = (n[0, 0] * x + n[0, 1] * y + n[0, 2]) / w, (n[1, 0] * x + n[1, 1] * y + n[1, 2]) / w
        out[i, 0], out[i, 1] = distort_point(u, v, radial_b, lens_b)
    return out


@compiled
def undistort_points(raw: Floats, radial: Floats, lens: LensShape, out: Floats) -> None:
    """Convert raw pixels (k, 2) to undistorted pixels, which are written to `out` (k, 2)."""
    for i in range(len(raw)):
        out[i, 0], out[i, 1] = undistort_point(raw[i, 0], raw[i, 1], radial, lens)


@compiled
def distort_points(points: Floats, radial: Floats, lens: LensShape, out: Floats) -> None:
    """Convert undistorted pixels (k, 2) to raw pixels, which are written to `out` (k, 2)."""
    for i in range(len(points)):
        out[i, 0], out[i, 1] = distort_point(points[i, 0], points[i, 1], radial, lens)


@inlined
def _evaluate_polynomial(radial: Floats, rho2: float) -> tuple[float, float]:
    """Return the distortion factor 1 + a1·ρ² + … and the derivative of ρ·factor by ρ, for a given ρ² (`rho2`)."""
    factor, slope, power = 1.0, 1.0, 1.0
    for k in range(len(radial)):
        power *= rho2
        factor += radial[k] * power
        slope += (2 * k + 3) * radial[k] * power
    return factor, slope


@inlined
def undistort_point(u: float, v: float, radial: Floats, lens: LensShape) -> tuple[float, float]:
    """Convert one raw pixel (u, v) to an undistorted pixel. Only compiled functions call this function."""
    if len(radial) == 0:
        return u, v
    x0, y0, radius, _, _ = lens
    x, y = u - x0, v - y0
    factor, _ = _evaluate_polynomial(radial, (x * x + y * y) / radius**2)
    return x0 + x * factor, y0 + y * factor


@inlined
def distort_point(u: float, v: float, radial: Floats, lens: LensShape) -> tuple[float, float]:
    """Convert one undistorted pixel (u, v) to a raw pixel by Newton's method. Only compiled functions call it."""
    if len(radial) == 0:
        return u, v
    x0, y0, radius, edge, furthest = lens
    x, y = u - x0, v - y0
    reach = math.sqrt(x * x + y * y) / radius
    # A point beyond the turning point has no solution: solve for the turning point and add the excess afterwards.
    inside = min(reach, furthest)
    rho = inside
    for _ in range(_MAX_NEWTON_STEPS):
        factor, slope = _evaluate_polynomial(radial, rho * rho)
        # The slope vanishes at the turning point. Its lower limit keeps the step finite, and the limits of rho keep it
        # in range.
        step = (rho * factor - inside) / max(slope, 1e-12)
        rho = min(max(rho - step, 0.0), edge)
        if abs(step) <= _CONVERGED * (1 + rho):
            break
    shrink = (rho + reach - inside) / reach if reach > 0 else 1.0
    return x0 + x * shrink, y0 + y * shrink
