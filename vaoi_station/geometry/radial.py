"""The loops of `Lens`, compiled; imported when a lens that distorts is first used, for the compiler takes a second."""

from __future__ import annotations

import math

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats

_NEWTON_STEPS = 30
_CONVERGED = 1e-14


@compiled
def _polynomial(radial: Floats, rho2: float) -> tuple[float, float]:
    """1 + a1·ρ² + … and the slope of ρ times that, at a squared radius in units of R²."""
    factor, slope, power = 1.0, 1.0, 1.0
    for k in range(len(radial)):
        power *= rho2
        factor += radial[k] * power
        slope += (2 * k + 3) * radial[k] * power
    return factor, slope


@compiled
def undistort(raw: Floats, radial: Floats, x0: float, y0: float, radius: float, out: Floats) -> None:
    """Undistorted points (k, 2) of raw ones, for coefficients a1, a2, … about (x0, y0)."""
    for n in range(len(raw)):
        x, y = raw[n, 0] - x0, raw[n, 1] - y0
        factor, _ = _polynomial(radial, (x * x + y * y) / radius**2)
        out[n, 0], out[n, 1] = x0 + x * factor, y0 + y * factor


@compiled
def distort(
    points: Floats, radial: Floats, x0: float, y0: float, radius: float, edge: float, furthest: float, out: Floats
) -> None:
    """Raw points (k, 2) of undistorted ones, by Newton's method; `edge` and `furthest` as in `Lens._end`."""
    for n in range(len(points)):
        x, y = points[n, 0] - x0, points[n, 1] - y0
        reach = math.sqrt(x * x + y * y) / radius
        inside = min(reach, furthest)
        rho = inside
        for _ in range(_NEWTON_STEPS):
            factor, slope = _polynomial(radial, rho * rho)
            step = (rho * factor - inside) / max(slope, 1e-12)
            rho = min(max(rho - step, 0.0), edge)
            if abs(step) <= _CONVERGED * (1 + rho):
                break
        shrink = (rho + reach - inside) / reach if reach > 0 else 1.0
        out[n, 0], out[n, 1] = x0 + x * shrink, y0 + y * shrink
