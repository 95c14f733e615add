"""Radial lens distortion: raw pixels to undistorted ones and back.

undistorted = c + (raw − c)·(1 + a1·ρ² + a2·ρ⁴ + …) with ρ = |raw − c| / R, as `formats.md` fixes it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from vaoi_station.geometry.transforms import Floats

_NEWTON_STEPS = 30
_CONVERGED = 1e-14
_NEVER = 1e-12
"""1 / ρ² of a turning point so far out that nothing is ever projected there."""


@dataclass(frozen=True)
class Lens:
    """Radial distortion about a centre; no coefficients mean an ideal lens."""

    center_px: tuple[float, float]
    radius_px: float
    radial: tuple[float, ...] = ()

    @property
    def ideal(self) -> bool:
        """Whether raw and undistorted pixels are the same."""
        return not any(self.radial)

    def undistort(self, raw_px: ArrayLike) -> Floats:
        """Undistorted pixels (..., 2) of raw ones (..., 2)."""
        p = np.asarray(raw_px, dtype=np.float64)
        if self.ideal:
            return p
        q = p - self.center_px
        rho2 = (q**2).sum(-1, keepdims=True) / self.radius_px**2
        return np.asarray(self.center_px + q * self._polynomial(rho2)[0], dtype=np.float64)

    def distort(self, undistorted_px: ArrayLike) -> Floats:
        """Raw pixels (..., 2) of undistorted ones (..., 2), by Newton's method (to 1e-9 px).

        Where the polynomial turns back, no raw pixel belongs to a point; such points are put beyond that
        radius, further out the further they are, and so do not land inside a frame the lens is made for.
        """
        u = np.asarray(undistorted_px, dtype=np.float64)
        if self.ideal:
            return u
        offset = u - self.center_px
        reach = np.sqrt((offset**2).sum(-1, keepdims=True)) / self.radius_px
        return np.asarray(self.center_px + offset * self._shrink(reach), dtype=np.float64)

    @cached_property
    def turning_point(self) -> float:
        """The smallest ρ at which the polynomial stops growing; infinite for a lens that never turns back."""
        inverse = np.roots([(2 * k + 1) * a for k, a in enumerate((1.0, *self.radial))])  # roots in 1 / ρ²
        real = [float(r.real) for r in inverse if abs(r.imag) < 1e-9 * abs(r) and r.real > _NEVER]
        return 1 / math.sqrt(max(real)) if real else math.inf

    def _shrink(self, reach: Floats) -> Floats:
        """ρ_raw / ρ_undistorted for undistorted radii in units of R."""
        edge = self.turning_point
        furthest = edge * float(self._polynomial(np.array(edge**2))[0]) if math.isfinite(edge) else math.inf
        inside, beyond = np.minimum(reach, furthest), reach >= furthest
        rho = np.where(beyond, edge, inside)
        for _ in range(_NEWTON_STEPS):
            factor, slope = self._polynomial(rho**2)
            step = np.where(beyond, 0.0, (rho * factor - inside) / np.maximum(slope, 1e-12))
            rho = np.clip(rho - step, 0.0, edge)
            if (np.abs(step) <= _CONVERGED * (1 + rho)).all():
                break
        rho = rho + (reach - inside)
        return np.divide(rho, reach, out=np.ones_like(rho), where=reach > 0)

    def _polynomial(self, rho2: Floats) -> tuple[Floats, Floats]:
        """1 + a1·ρ² + … and the slope of ρ times that, at squared radii in units of R²."""
        factor, slope, power = np.ones_like(rho2), np.ones_like(rho2), np.ones_like(rho2)
        for k, a in enumerate(self.radial, start=1):
            power = power * rho2
            factor = factor + a * power
            slope = slope + (2 * k + 1) * a * power
        return factor, slope
