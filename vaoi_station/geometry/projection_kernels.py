"""Compiled projection between pixels and points above the belt: lens, N_i and height in one pass.

The module is imported on first use, because Numba takes a moment to load.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats

LensShape = tuple[float, float, float, float, float]
_MAX_NEWTON_STEPS = 30
_CONVERGED = 1e-14


class CameraArrays(NamedTuple):
    """c cameras, in the form that compiled functions take."""

    image_from_row: Floats  # (c, 3, 3) N_i
    row_from_image: Floats  # (c, 3, 3) the inverse N_i
    radial: Floats  # (c, r) coefficients a1, a2, … of the lenses; shorter ones are filled up with zeros
    lens: Floats  # (c, 5) `Lens.shape`
    viewpoint: Floats  # (c, 3) foot of the camera, x and y in mm, and inverse working distance; 0 if it is unknown


@compiled
def ground_to_image(place: Floats, height: Floats, cameras: CameraArrays, out: Floats) -> None:
    """Project points (k, 2), mm in row coordinates, to raw pixels of the first camera, written to `out` (k, 2).

    `height` has the heights above the calibrated plane (k,), mm, or one (1,) for all points.
    """
    x0, y0, inverse = cameras.viewpoint[0]
    for i in range(len(place)):
        # The ray from the camera through the raised point meets the calibrated plane further away from the foot.
        share = height[i if len(height) > 1 else 0] * inverse
        x, y = (place[i, 0] - share * x0) / (1 - share), (place[i, 1] - share * y0) / (1 - share)
        out[i, 0], out[i, 1] = ground_to_raw(x, y, 0, cameras)


@compiled
def image_to_ground(raw: Floats, height: Floats, cameras: CameraArrays, out: Floats) -> None:
    """Project raw pixels (k, 2) of the first camera to points at known heights: the inverse of `ground_to_image`."""
    x0, y0, inverse = cameras.viewpoint[0]
    for i in range(len(raw)):
        x, y, _, _ = raw_to_ground(raw[i, 0], raw[i, 1], 0, cameras)
        share = height[i if len(height) > 1 else 0] * inverse
        out[i, 0], out[i, 1] = x + (x0 - x) * share, y + (y0 - y) * share


@compiled
def transfer_points(raw: Floats, a: CameraArrays, b: CameraArrays, shift_mm: Floats) -> Floats:
    """Return the raw pixels (k, 2) of camera b that show the same points of the calibrated plane as those of camera a.

    The points move by `shift_mm` (2,) between the exposures of the two cameras.
    """
    out = np.empty((len(raw), 2))
    for i in range(len(raw)):
        x, y, _, _ = raw_to_ground(raw[i, 0], raw[i, 1], 0, a)
        out[i, 0], out[i, 1] = ground_to_raw(x + shift_mm[0], y + shift_mm[1], 0, b)
    return out


@inlined
def raw_to_ground(x: float, y: float, i: int, cameras: CameraArrays) -> tuple[float, float, float, float]:
    """Return the point of the calibrated plane that a raw pixel of camera i shows, and its undistorted pixel."""
    n, s = cameras.row_from_image[i], cameras.lens[i]
    u, v = undistort_point(x, y, cameras.radial[i], (s[0], s[1], s[2], s[3], s[4]))
    w = n[2, 0] * u + n[2, 1] * v + n[2, 2]
    return (n[0, 0] * u + n[0, 1] * v + n[0, 2]) / w, (n[1, 0] * u + n[1, 1] * v + n[1, 2]) / w, u, v


@inlined
def ground_to_raw(x: float, y: float, i: int, cameras: CameraArrays) -> tuple[float, float]:
    """Return the raw pixel in which camera i shows a point of the calibrated plane."""
    n, s = cameras.image_from_row[i], cameras.lens[i]
    w = n[2, 0] * x + n[2, 1] * y + n[2, 2]
    u, v = (n[0, 0] * x + n[0, 1] * y + n[0, 2]) / w, (n[1, 0] * x + n[1, 1] * y + n[1, 2]) / w
    return distort_point(u, v, cameras.radial[i], (s[0], s[1], s[2], s[3], s[4]))


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
