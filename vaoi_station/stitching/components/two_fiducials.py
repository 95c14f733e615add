"""An error of one of two fiducials, as the components show it.

Two fiducials determine the four numbers of C and leave no residual. An error of one of them shifts, turns and stretches
what C predicts, and leaves the other in place. The components test this one hypothesis, of two numbers, against none:
that is sharper than their test of any shift, turn and stretch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.observations import Ints
from vaoi_station.stitching.adjustment.problem import FiducialPoints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.components.shift import ComponentShift

_ALIKE_MM = np.array([0.012, 0.012, 0.004, 0.004])
"""Standard deviations of what placement and light change in all components alike: shift, turn and stretch, mm, as in
`ComponentShift.measured`. A light from one side shifts what is seen of all components, but hardly turns it."""
_LIMIT = 10.0
"""Largest part of χ² that an error of one fiducial explains (2 degrees of freedom) and that is none. Measured: correct
boards reach 6.1 (hostile.md)."""
_SURELY = 2.0
"""Number of standard deviations beyond the limit at which an error is shown with a probability of 98 %."""


class FiducialError(NamedTuple):
    """An error of one of two fiducials that explains where the components are seen."""

    which: int
    """0 or 1: which of the two."""
    mm: float
    """Distance of the fiducial from its CAD position."""
    chi2: float
    """Part of χ² that the error explains."""


def two_that_place(plane: BoardPlane, points: FiducialPoints | None) -> Ints | None:
    """Return the numbers (2,) of the two fiducials that alone determine C; None if more points do.

    Args:
        plane: plane of the board type.
        points: the points of the adjustment.
    """
    if points is None or (points.which < 0).any():
        return None
    found = set(points.which.tolist())
    # Fiducials of components and boards have no part in C.
    used = np.array(sorted(found - plane.board_type.apart_from_c(found)), np.int_)
    return used if len(used) == 2 else None


def likely_errors(shift: ComponentShift, fiducials_mm: Floats) -> list[FiducialError]:
    """Return the errors of one of two fiducials that the components show, the likeliest first; none if both fit.

    Args:
        shift: what the components show.
        fiducials_mm: (2, 2) places of the fiducials by C, tester coordinates, mm.
    """
    weight, out = _information(shift), []
    for n, effect in enumerate(_effects(shift, fiducials_mm)):
        information, product = effect.T @ weight @ effect, effect.T @ weight @ shift.measured
        error = np.linalg.solve(information, product)
        out.append(FiducialError(n, float(np.hypot(*error)), float(product @ error)))
    return sorted((e for e in out if e.chi2 > _LIMIT), key=lambda e: -e.chi2)


def unnoticed_mm(shift: ComponentShift, fiducials_mm: Floats) -> float:
    """Return the error of one of two fiducials (2, 2), tester coordinates, mm, that the components surely show.

    A smaller error in the least favourable direction may leave all checks silent.
    """
    weight = _information(shift)
    weakest = min(float(np.linalg.eigvalsh(e.T @ weight @ e)[0]) for e in _effects(shift, fiducials_mm))
    return (math.sqrt(_LIMIT) + _SURELY) / math.sqrt(max(weakest, 1e-12))


def _information(shift: ComponentShift) -> Floats:
    """Return the inverse (4, 4) of the covariance of what the components show, 1/mm²."""
    return np.asarray(np.linalg.inv(shift.by_centres + np.diag(_ALIKE_MM**2)))


def _effects(shift: ComponentShift, fiducials_mm: Floats) -> list[Floats]:
    """Return for each of two fiducials the change (4, 2) of what the components show by 1 mm of error along x and y."""
    place, middle = fiducials_mm @ (1, 1j), complex(*shift.middle_mm)
    out = []
    for own, other in (place, place[::-1]):
        slope = np.array([1, 1j]) / (own - other)
        moved, arm = slope * (middle - other), slope * shift.arm_mm
        out.append(np.stack([moved.real, moved.imag, arm.imag, arm.real]))
    return out
