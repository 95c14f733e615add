"""Heights of a clamped board: the surface as filmed, lifted, tilted and bent otherwise, as readings of z show it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vaoi_station.clamping.filmed import FilmedBoard
from vaoi_station.clamping.fit import FREE
from vaoi_station.geometry.transforms import Floats

TILT_MM = 0.5
"""Standard deviation of the tilt at the board's edge if fewer than three readings of z show it."""
_STEP = 1e-4
"""Step of the differences that give slopes, in half extents of the board."""


def _functions(film: FilmedBoard, cad: Floats) -> Floats:
    """Return 1, u, v, u², u·v, v² (k, 6) at CAD points (k, 2)."""
    middle, half = film.half
    # As of the surface, squares would grow too large far beyond the edge.
    u, v = np.clip((cad - middle) / half, -1.2, 1.2).T
    return np.stack([np.ones(len(u)), u, v, u * u, u * v, v * v], 1)


@dataclass(frozen=True, eq=False)
class Bending:
    """Lift, tilt and bow that a clamped board has beyond its surface as filmed, mm."""

    film: FilmedBoard
    values: Floats
    """(6,) factors of 1, u, v, u², u·v, v²."""
    covariance: Floats
    prior_mm: float
    """Standard deviation that was assumed of the change of the bow."""

    def z_mm(self, cad: Floats) -> Floats:
        """Return the heights (k,) of the surface at CAD points (k, 2)."""
        return self.film.height_mm(cad) + _functions(self.film, cad) @ self.values

    def sigma_mm(self, cad: Floats) -> Floats:
        """Return the standard deviations (k,) of `z_mm`."""
        f = _functions(self.film, cad)
        return np.asarray(np.sqrt(np.maximum(((f @ self.covariance) * f).sum(1), 0.0)))

    def slopes(self, cad: Floats) -> tuple[Floats, Floats]:
        """Return the slopes (k, 2) along CAD x and y, mm per CAD unit, and their standard deviations (k, 2)."""
        slope, sigma = np.empty((len(cad), 2)), np.empty((len(cad), 2))
        for axis, step in enumerate(np.diag(_STEP * self.film.half[1])):
            ahead, behind = cad + step, cad - step
            change = (_functions(self.film, ahead) - _functions(self.film, behind)) / (2 * step[axis])
            filmed = (self.film.height_mm(ahead) - self.film.height_mm(behind)) / (2 * step[axis])
            slope[:, axis] = filmed + change @ self.values
            sigma[:, axis] = np.sqrt(np.maximum(((change @ self.covariance) * change).sum(1), 0.0))
        return slope, sigma


def level(film: FilmedBoard, numbers: list[int], bow_mm: float) -> Bending:
    """Return heights above the plane through fiducials as filmed, for a tester that gives no z."""
    f = _functions(film, film.cad[numbers])
    # What the plane follows of a bow at the fiducials is taken from it. Few or collinear ones leave a tilt at 0.
    follows = -np.linalg.pinv(f[:, :3])
    bowed = np.vstack([follows @ f[:, 3:], np.eye(3)])
    values = np.r_[follows @ film.height_mm(film.cad[numbers]), np.zeros(3)]
    sigma = float(np.hypot(bow_mm, film.surface_sigma_mm))
    return Bending(film, values, sigma**2 * bowed @ bowed.T, sigma)


def bent(film: FilmedBoard, numbers: list[int], z_mm: Floats, sigma_mm: Floats, bow_mm: float) -> Bending:
    """Return the heights that readings of z (k,) of fiducials show, with standard deviations (k,)."""
    f = _functions(film, film.cad[numbers])
    flat = np.linalg.matrix_rank(f[:, :3]) == 3
    tilt, bow = FREE if flat else TILT_MM, float(np.hypot(bow_mm, film.surface_sigma_mm))
    weighted = f * (sigma_mm**-2.0)[:, None]
    normal = weighted.T @ f + np.diag(np.array([FREE, tilt, tilt, bow, bow, bow]) ** -2.0)
    covariance: Floats = np.asarray(np.linalg.inv(normal), np.float64)
    return Bending(film, covariance @ weighted.T @ (z_mm - film.height_mm(film.cad[numbers])), covariance, bow)
