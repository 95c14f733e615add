"""Between pixels and places, one compiled pass per set of points: lens, N_i, height.

Imported when a camera is first used, for the compiler takes a moment to load. `lens` is (x0, y0, R, edge, furthest):
centre and radius in px, the raw ρ at which the polynomial stops growing and the undistorted ρ there; `radial`
holds a1, a2, … and is empty for an ideal lens. `eye` is (x, y, 1 / d): the foot and the inverse of the distance.
"""

from __future__ import annotations

import math

import numpy as np

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats

LensShape = tuple[float, float, float, float, float]
_NEWTON_STEPS = 30
_CONVERGED = 1e-14


@compiled
def ground_to_image(
    place: Floats,
    height: Floats,
    eye: tuple[float, float, float],
    n: Floats,
    radial: Floats,
    lens: LensShape,
    out: Floats,
) -> None:
    """Raw pixels (k, 2) of places (k, 2) in mm at heights (k,), or (1,) for one height of all; n is N_i."""
    x0, y0, inverse = eye
    for i in range(len(place)):
        share = height[i if len(height) > 1 else 0] * inverse
        x, y = (place[i, 0] - share * x0) / (1 - share), (place[i, 1] - share * y0) / (1 - share)
        w = n[2, 0] * x + n[2, 1] * y + n[2, 2]
        u, v = (n[0, 0] * x + n[0, 1] * y + n[0, 2]) / w, (n[1, 0] * x + n[1, 1] * y + n[1, 2]) / w
        out[i, 0], out[i, 1] = distort_point(u, v, radial, lens)


@compiled
def image_to_ground(
    raw: Floats,
    height: Floats,
    eye: tuple[float, float, float],
    n: Floats,
    radial: Floats,
    lens: LensShape,
    out: Floats,
) -> None:
    """Places (k, 2) in mm of raw pixels (k, 2) at heights (k,), or (1,) for one height of all; n is N_i⁻¹."""
    x0, y0, inverse = eye
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
    """Raw pixels (k, 2) in camera b of points of the plane seen at raw pixels (k, 2) of a, after a shift (2,)."""
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
    """Undistorted pixels (k, 2) of raw ones."""
    for i in range(len(raw)):
        out[i, 0], out[i, 1] = undistort_point(raw[i, 0], raw[i, 1], radial, lens)


@compiled
def distort_points(points: Floats, radial: Floats, lens: LensShape, out: Floats) -> None:
    """Raw pixels (k, 2) of undistorted ones."""
    for i in range(len(points)):
        out[i, 0], out[i, 1] = distort_point(points[i, 0], points[i, 1], radial, lens)


@inlined
def _evaluate_polynomial(radial: Floats, rho2: float) -> tuple[float, float]:
    """1 + a1·ρ² + … and the slope of ρ times that, at a squared radius in units of R²."""
    factor, slope, power = 1.0, 1.0, 1.0
    for k in range(len(radial)):
        power *= rho2
        factor += radial[k] * power
        slope += (2 * k + 3) * radial[k] * power
    return factor, slope


@inlined
def undistort_point(u: float, v: float, radial: Floats, lens: LensShape) -> tuple[float, float]:
    """One point."""
    if len(radial) == 0:
        return u, v
    x0, y0, radius, _, _ = lens
    x, y = u - x0, v - y0
    factor, _ = _evaluate_polynomial(radial, (x * x + y * y) / radius**2)
    return x0 + x * factor, y0 + y * factor


@inlined
def distort_point(u: float, v: float, radial: Floats, lens: LensShape) -> tuple[float, float]:
    """One raw pixel of an undistorted one, by Newton's method; for compiled functions."""
    if len(radial) == 0:
        return u, v
    x0, y0, radius, edge, furthest = lens
    x, y = u - x0, v - y0
    reach = math.sqrt(x * x + y * y) / radius
    inside = min(reach, furthest)
    rho = inside
    for _ in range(_NEWTON_STEPS):
        factor, slope = _evaluate_polynomial(radial, rho * rho)
        step = (rho * factor - inside) / max(slope, 1e-12)
        rho = min(max(rho - step, 0.0), edge)
        if abs(step) <= _CONVERGED * (1 + rho):
            break
    shrink = (rho + reach - inside) / reach if reach > 0 else 1.0
    return x0 + x * shrink, y0 + y * shrink
