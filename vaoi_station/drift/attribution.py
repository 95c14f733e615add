"""Attribution of motion to cameras: the displacements that explain the evidence with the fewest cameras moved.

Links between neighbours show how cameras moved against one another. They do not show a motion of the whole array, and
along the row of cameras they do not separate a stretch of the array from boards that lie higher. A camera is either
where it was calibrated, to a few hundredths of a pixel, or it was moved by an unknown amount. That is a prior with
heavy tails (Student's t with one degree of freedom, one per camera). Under it the most likely of all displacements that
explain the links is the one in which most cameras have not moved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vaoi_station.drift.displacement import PARAMETERS
from vaoi_station.geometry.transforms import Floats

STILL_PX = 0.03
"""Standard deviation of a camera that was not moved, for each of x, y and turn."""
MOVED_PX = 2 * STILL_PX
"""Displacement (root of the sum of the three squares) above which a camera counts as moved."""
_WIDE_PX = 100.0
_ITERATIONS = 60
_CLOSE = 10.0
"""Difference of log-probability up to which two explanations are equally good.

Only the keystone of a turn separates them, and a camera that was shifted instead of turned has none."""


@dataclass(frozen=True, eq=False)
class Attribution:
    """Displacements in px of n cameras, with their covariance under this attribution."""

    displacement_px: Floats
    """(n, 3)."""
    covariance: Floats
    """(3n, 3n) px²."""
    rivals: tuple[int, ...] = ()
    """Cameras that have moved by another explanation that is as good, but not by this one."""

    @property
    def moved(self) -> tuple[int, ...]:
        """Cameras whose displacement exceeds `MOVED_PX`."""
        return tuple(np.flatnonzero(np.hypot.reduce(self.displacement_px, axis=1) > MOVED_PX).tolist())

    @property
    def sigma_px(self) -> Floats:
        """(n, 3) standard deviations."""
        return np.asarray(np.sqrt(np.diag(self.covariance)).reshape(-1, PARAMETERS))


def attribute_motion(information: Floats, vector: Floats) -> Attribution:
    """Find the most likely displacements for information (3n, 3n) px⁻² and vector (3n,) px⁻¹."""
    # The probability has several maxima, so one search starts from each camera as the fixed one.
    found = [_maximum(information, vector, still) for still in range(len(vector) // PARAMETERS)]
    least, best = min(found, key=lambda f: f[0])
    good = [a for cost, a in found if cost < least + _CLOSE and len(a.moved) == len(best.moved)]
    # Of equally good ones the first by camera number: the same array gets the same explanation run after run.
    first = min(good, key=lambda a: a.moved) if best.moved else best
    others = {camera for a in good for camera in a.moved} - {*first.moved}
    return Attribution(first.displacement_px, first.covariance, tuple(sorted(others)))


def _maximum(information: Floats, vector: Floats, still: int) -> tuple[float, Attribution]:
    """Climb to a maximum from one fixed camera by reweighting (EM); return minus its logarithm, and the maximum."""
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
