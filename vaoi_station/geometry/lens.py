"""Radial lens distortion: conversion between raw and undistorted pixels.

undistorted = c + (raw − c)·(1 + a1·ρ² + a2·ρ⁴ + …) with ρ = |raw − c| / R, as docs/formats.md defines it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from vaoi_station.geometry.transforms import Floats

_MAX_NEWTON_STEPS = 30
_CONVERGED = 1e-14
_NEGLIGIBLE = 1e-12
"""Roots 1 / ρ² below this are ignored: such a turning point lies a million radii away, where no point is projected."""


@dataclass(frozen=True)
class Lens:
    """Radial distortion about a centre; a lens without coefficients is ideal."""

    center_px: tuple[float, float]
    radius_px: float
    radial: tuple[float, ...] = ()

    @property
    def ideal(self) -> bool:
        """Whether raw and undistorted pixels are equal."""
        return not any(self.radial)

    def undistort(self, raw_px: ArrayLike) -> Floats:
        """Convert raw pixels (..., 2) to undistorted pixels (..., 2)."""
        raw = np.asarray(raw_px, dtype=np.float64)
        if self.ideal:
            return raw
        out = raw - self.center_px
        out *= self._polynomial((out * out).sum(-1) / self.radius_px**2)[0][..., None]
        return np.asarray(out + self.center_px)

    def distort(self, undistorted_px: ArrayLike) -> Floats:
        """Convert undistorted pixels (..., 2) to raw pixels (..., 2) by Newton's method, to 1e-9 px.

        Beyond the turning point of the polynomial a point has no raw pixel. Such a point is mapped beyond the
        turning radius, monotonically, so that it never lands inside the frame.
        """
        points = np.asarray(undistorted_px, dtype=np.float64)
        if self.ideal:
            return points
        out = points - self.center_px
        reach = np.sqrt((out * out).sum(-1)) / self.radius_px
        *_, edge, furthest = self.shape
        # A point beyond the turning point has no solution: solve for the turning point and add the excess afterwards.
        inside = np.minimum(reach, furthest)
        rho = inside
        for _ in range(_MAX_NEWTON_STEPS):
            factor, slope = self._polynomial(rho * rho)
            # The slope vanishes at the turning point. Its lower limit keeps the step finite, and the limits of rho keep
            # it in range.
            step = (rho * factor - inside) / np.maximum(slope, 1e-12)
            rho = np.clip(rho - step, 0.0, edge)
            if (np.abs(step) <= _CONVERGED * (1 + rho)).all():
                break
        out *= np.divide(rho + reach - inside, reach, out=np.ones_like(reach), where=reach > 0)[..., None]
        return np.asarray(out + self.center_px)

    def _polynomial(self, rho2: Floats) -> tuple[Floats, Floats]:
        """Return the distortion factor 1 + a1·ρ² + … and the derivative of ρ·factor by ρ, for given ρ² (`rho2`)."""
        factor, slope = np.zeros_like(rho2), np.zeros_like(rho2)
        for k, a in reversed([*enumerate((1.0, *self.radial))]):
            factor, slope = factor * rho2 + a, slope * rho2 + (2 * k + 1) * a
        return factor, slope

    @cached_property
    def coefficients(self) -> Floats:
        """The coefficients a1, a2, … of the distortion, as `geometry.projection_kernels` takes them; empty if ideal."""
        return np.array(() if self.ideal else self.radial, dtype=np.float64)

    @cached_property
    def shape(self) -> tuple[float, float, float, float, float]:
        """(x0, y0, R, edge, furthest): centre, radius, raw and undistorted ρ of the turning point (∞ without one)."""
        edge = furthest = self.turning_point
        if math.isfinite(edge):
            furthest = edge * (1 + sum(a * edge ** (2 * k) for k, a in enumerate(self.radial, start=1)))
        return float(self.center_px[0]), float(self.center_px[1]), float(self.radius_px), edge, furthest

    @cached_property
    def turning_point(self) -> float:
        """The smallest raw ρ at which the undistorted ρ stops growing; infinite if it always grows."""
        # The derivative of ρ·(1 + a1·ρ² + …) is a polynomial in ρ². Its roots are computed in 1 / ρ², so that a
        # vanishing last coefficient gives a root at 0 and not a division by zero.
        inverse = np.roots([(2 * k + 1) * a for k, a in enumerate((1.0, *self.radial))])
        real = [float(r.real) for r in inverse if abs(r.imag) < 1e-9 * abs(r) and r.real > _NEGLIGIBLE]
        return 1 / math.sqrt(max(real)) if real else math.inf
