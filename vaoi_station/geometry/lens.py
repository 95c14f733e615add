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
        return self._converted(raw_px, "undistort_points")

    def distort(self, undistorted_px: ArrayLike) -> Floats:
        """Convert undistorted pixels (..., 2) to raw pixels (..., 2) by Newton's method, to 1e-9 px.

        Beyond the turning point of the polynomial a point has no raw pixel. Such a point is mapped beyond the
        turning radius, monotonically, so that it never lands inside the frame.
        """
        return self._converted(undistorted_px, "distort_points")

    def _converted(self, px: ArrayLike, kernel: str) -> Floats:
        p = np.asarray(px, dtype=np.float64)
        if self.ideal:
            return p
        # Imported here: Numba takes a moment to load, and an ideal lens needs no compiled code.
        from vaoi_station.geometry import projection_kernels

        out = np.empty(p.shape)
        getattr(projection_kernels, kernel)(p.reshape(-1, 2), self.coefficients, self.shape, out.reshape(-1, 2))
        return out

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
