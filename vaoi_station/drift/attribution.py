"""Attribution of motion to cameras: the displacements that explain the evidence with the fewest cameras moved.

Links between neighbouring cameras show how these cameras moved against one another. Links do not show a motion of the
whole array. A stretch of the array along the row of cameras looks to them like boards that lie higher. A camera is
either where it was calibrated, to a few hundredths of a pixel, or it was moved by an unknown amount. This knowledge is
a prior with heavy tails for each camera: Student's t distribution with one degree of freedom. Under this prior, of all
displacements that explain the links, those in which most cameras have not moved are the most likely.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vaoi_station.drift.displacement import PARAMETERS
from vaoi_station.geometry.transforms import Floats

STILL_PX = 0.03
"""Standard deviation of the displacement of a camera that was not moved, for each of x, y and turn."""
MOVED_PX = 2 * STILL_PX
"""Length of the displacement vector (x, y, turn) above which a camera counts as moved."""
_WIDE_PX = 100.0
_ITERATIONS = 60
_CLOSE = 10.0
"""Difference of log-probability up to which two explanations count as equally good.

Two explanations can name different cameras. Only the keystone distortion that a turned camera shows decides between
them, and a camera that was shifted instead of turned shows no keystone distortion."""


@dataclass(frozen=True, eq=False)
class Attribution:
    """The most likely displacements of n cameras with covariances, and the cameras that may have moved instead."""

    displacement_px: Floats
    """(n, 3) displacement x, y and turn of each camera."""
    covariance: Floats
    """(3n, 3n) covariance of the displacements, px², camera by camera."""
    rivals: tuple[int, ...] = ()
    """Cameras that have moved in another, equally good explanation, but have not moved in this one."""

    @property
    def moved(self) -> tuple[int, ...]:
        """Cameras whose displacement exceeds `MOVED_PX`."""
        return tuple(np.flatnonzero(np.hypot.reduce(self.displacement_px, axis=1) > MOVED_PX).tolist())

    @property
    def sigma_px(self) -> Floats:
        """Standard deviations (n, 3) of the displacements."""
        return np.asarray(np.sqrt(np.diag(self.covariance)).reshape(-1, PARAMETERS))


def attribute_motion(information: Floats, vector: Floats) -> Attribution:
    """Find the most likely displacements of n cameras, and the cameras that may have moved instead.

    Args:
        information: (3n, 3n) px⁻², normal matrix of the displacements (`equations.DisplacementEstimate`).
        vector: (3n,) px⁻¹, right-hand side of the same normal equations.
    """
    # The probability has several maxima, so one search starts from each camera as the fixed one.
    found = [_maximum(information, vector, still) for still in range(len(vector) // PARAMETERS)]
    least, best = min(found, key=lambda f: f[0])
    good = [a for cost, a in found if cost < least + _CLOSE and len(a.moved) == len(best.moved)]
    # Of equally good explanations, take the one with the lowest camera numbers: every run then names the same camera.
    first = min(good, key=lambda a: a.moved) if best.moved else best
    others = {camera for a in good for camera in a.moved} - {*first.moved}
    return Attribution(first.displacement_px, first.covariance, tuple(sorted(others)))


def _maximum(information: Floats, vector: Floats, still: int) -> tuple[float, Attribution]:
    """Find one local maximum of the probability, by iterative reweighting (EM) that starts with camera `still` fixed.

    Return the negative log-probability of the maximum, up to a constant, and the displacements there.
    """
    weight = np.full(len(vector), 1 / _WIDE_PX**2)
    weight[PARAMETERS * still : PARAMETERS * (still + 1)] = 1 / STILL_PX**2
    for _ in range(_ITERATIONS):
        d = np.linalg.solve(information + np.diag(weight), vector)
        moved = (d.reshape(-1, PARAMETERS) ** 2).sum(1)
        weight = np.repeat((1 + PARAMETERS) / (STILL_PX**2 + moved), PARAMETERS)
    cost = float(d @ information @ d / 2 - d @ vector) + (1 + PARAMETERS) / 2 * float(
        np.log1p(moved / STILL_PX**2).sum()
    )
    covariance = np.asarray(np.linalg.inv(information + np.diag(weight)), dtype=np.float64)
    return cost, Attribution(np.asarray(d.reshape(-1, PARAMETERS), dtype=np.float64), covariance)
