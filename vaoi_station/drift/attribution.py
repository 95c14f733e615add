"""Whose motion it was: the displacements that explain what was told with as few cameras moved as possible.

Links between neighbours tell how cameras moved against one another; that the whole array moved, they cannot tell,
nor, along the row of cameras, a stretch of the array from boards that lie higher. A camera either hangs where it was
calibrated, to a few hundredths of a pixel, or somebody has moved it by an unknown amount. That is a prior
with heavy tails (Student's t with one degree of freedom, one per camera), and of all displacements
that explain the links the one in which most cameras have not moved is the most likely.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vaoi_station.drift.displacement import PARAMETERS
from vaoi_station.geometry.transforms import Floats

STILL_PX = 0.03
"""How well a camera that nobody has touched is known (1 σ, each of x, y and turn)."""
MOVED_PX = 2 * STILL_PX
"""A larger displacement (root of the sum of the three squares) is more likely a move than an error of calibration."""
_WIDE_PX = 100.0
_ITERATIONS = 60
_CLOSE = 10.0
"""Explanations by equally many cameras whose logarithms of probability differ by less are equally good: what tells them
apart is the keystone of a turn, which a shifted camera does not have."""


@dataclass(frozen=True, eq=False)
class Attribution:
    """Displacements in px of n cameras, with their covariance given who has moved."""

    displacement_px: Floats
    """(n, 3)."""
    covariance: Floats
    """(3n, 3n) px²."""
    rivals: tuple[int, ...] = ()
    """Cameras that have not moved by this explanation, but have by another one that is as good."""

    @property
    def moved(self) -> tuple[int, ...]:
        """Cameras that are displaced by more than they are known."""
        return tuple(np.flatnonzero(np.hypot.reduce(self.displacement_px, axis=1) > MOVED_PX).tolist())

    @property
    def sigma_px(self) -> Floats:
        """(n, 3) standard deviations."""
        return np.asarray(np.sqrt(np.diag(self.covariance)).reshape(-1, PARAMETERS))


def attribute_motion(information: Floats, vector: Floats) -> Attribution:
    """The displacements behind information (3n, 3n) px⁻² and vector (3n,) px⁻¹.

    The probability has several maxima: one is sought from each camera taken as fixed. Of equally good ones the first
    is taken, so that the same array is explained the same way run after run.
    """
    found = [_maximum(information, vector, still) for still in range(len(vector) // PARAMETERS)]
    least, best = min(found, key=lambda f: f[0])
    good = [a for cost, a in found if cost < least + _CLOSE and len(a.moved) == len(best.moved)]
    first = min(good, key=lambda a: a.moved) if best.moved else best
    others = {camera for a in good for camera in a.moved} - {*first.moved}
    return Attribution(first.displacement_px, first.covariance, tuple(sorted(others)))


def _maximum(information: Floats, vector: Floats, still: int) -> tuple[float, Attribution]:
    """The maximum reached from one camera held fast, by reweighting (EM), and minus its logarithm."""
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
