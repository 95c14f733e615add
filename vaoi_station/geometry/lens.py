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
        from vaoi_station.geometry.projection_kernels import undistort_points

        out = np.empty(p.shape)
        undistort_points(p.reshape(-1, 2), self.coefficients, self.shape, out.reshape(-1, 2))
        return out

    def distort(self, undistorted_px: ArrayLike) -> Floats:
        """Raw pixels (..., 2) of undistorted ones (..., 2), by Newton's method (to 1e-9 px).

        Where the polynomial turns back, no raw pixel belongs to a point; such points are put beyond that
        radius, further out the further they are, and so do not land inside a frame the lens is made for.
        """
        u = np.asarray(undistorted_px, dtype=np.float64)
        if self.ideal:
            return u
        from vaoi_station.geometry.projection_kernels import distort_points

        out = np.empty(u.shape)
        distort_points(u.reshape(-1, 2), self.coefficients, self.shape, out.reshape(-1, 2))
        return out

    @cached_property
    def coefficients(self) -> Floats:
        """a1, a2, … as `geometry.projection_kernels` wants them: none for an ideal lens."""
        return np.array(() if self.ideal else self.radial, dtype=np.float64)

    @cached_property
    def shape(self) -> tuple[float, float, float, float, float]:
        """Centre, radius, the raw ρ at which the polynomial stops growing, the undistorted ρ there (or ∞)."""
        edge = furthest = self.turning_point
        if math.isfinite(edge):
            furthest = edge * (1 + sum(a * edge ** (2 * k) for k, a in enumerate(self.radial, start=1)))
        return float(self.center_px[0]), float(self.center_px[1]), float(self.radius_px), edge, furthest

    @cached_property
    def turning_point(self) -> float:
        """The smallest ρ at which the polynomial stops growing; infinite for a lens that never turns back."""
        inverse = np.roots([(2 * k + 1) * a for k, a in enumerate((1.0, *self.radial))])  # roots in 1 / ρ²
        real = [float(r.real) for r in inverse if abs(r.imag) < 1e-9 * abs(r) and r.real > _NEVER]
        return 1 / math.sqrt(max(real)) if real else math.inf
