"""Radial lens distortion: raw pixels to undistorted ones and back.

undistorted = c + (raw − c)·(1 + a1·ρ² + a2·ρ⁴ + …) with ρ = |raw − c| / R, as `formats.md` fixes it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vaoi_station.geometry.transforms import Floats

_FIXED_POINT_STEPS = 10


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
        return np.asarray(self.center_px + q * self._factor(q), dtype=np.float64)

    def distort(self, undistorted_px: ArrayLike) -> Floats:
        """Raw pixels (..., 2) of undistorted ones (..., 2), by fixed-point iteration (to 1e-9 px)."""
        u = np.asarray(undistorted_px, dtype=np.float64)
        if self.ideal:
            return u
        target = u - self.center_px
        q = target
        for _ in range(_FIXED_POINT_STEPS):
            q = target / self._factor(q)
        return np.asarray(q + self.center_px, dtype=np.float64)

    def _factor(self, offset_px: Floats) -> Floats:
        rho2 = (offset_px**2).sum(-1, keepdims=True) / self.radius_px**2
        total = np.ones_like(rho2)
        power = np.ones_like(rho2)
        for a in self.radial:
            power = power * rho2
            total = total + a * power
        return np.asarray(total, dtype=np.float64)
