"""Shift and turn that the displacements of a few fiducials show: of a board of a panel, or of one component."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vaoi_station.geometry.transforms import Floats


class ShiftAndTurn(NamedTuple):
    """A rigid motion of the board plane, tester coordinates."""

    matrix: Floats
    """(3, 3) from the place by C to the place that the fiducials show."""
    turn_rad: float
    """Turn about the middle of the fiducials; 0 with one fiducial."""
    middle_mm: Floats
    """(2,) middle of the fiducials by C."""
    spread_mm2: float
    """Sum of the squared distances of the fiducials from their middle: the σ of the turn is σ of one / √spread."""


def fit_shift_and_turn(at: Floats, shifts: Floats) -> ShiftAndTurn:
    """Fit shift and turn to displacements by least squares, with equal weights; one fiducial shows a shift only.

    The turn is the sine of the angle. Up to 0.5° the difference is at most 1.2e-7 rad.

    Args:
        at: (k, 2) where C puts k ≥ 1 fiducials, tester coordinates, mm.
        shifts: (k, 2) their displacements, mm.
    """
    middle, shift = at.mean(0), shifts.mean(0)
    arm = at - middle
    spread, turn = float((arm**2).sum()), 0.0
    if len(at) > 1:
        turn = float((arm[:, 0] * shifts[:, 1] - arm[:, 1] * shifts[:, 0]).sum()) / spread
    matrix = np.eye(3)
    c, s = np.cos(turn), np.sin(turn)
    matrix[:2, :2] = ((c, -s), (s, c))
    matrix[:2, 2] = middle + shift - matrix[:2, :2] @ middle
    return ShiftAndTurn(matrix, turn, middle, spread)
