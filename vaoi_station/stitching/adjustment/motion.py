"""The motion of the board over the rows, and its priors.

D_j moves the board from row 0 to row j. The adjustment estimates the inverse of D_j, as a rotation by φ_j about the
centre c of the camera array and a shift s_j. With this centre, angle and shift are nearly uncorrelated:

    board = R(φ_j)·(x − c) + c + s_j        for a point x of the conveyor's plane in row j
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry import Euclidean, System
from vaoi_station.geometry.transforms import Floats

Ints = NDArray[np.int_]

SPEED_TOLERANCE = 0.05  # standard deviation of the belt's mean speed, as a share of its nominal speed
STEP_TOLERANCE = 0.02  # standard deviation of the speed in one step between two rows, as a share of the mean speed
SWAY_MM = 0.15  # standard deviation of the motion across the belt between two rows
YAW_RAD = 0.003  # standard deviation of the rotation between two rows
SLIP_SHARE, PLAY_MM = 0.15, 1.0
"""Links are first searched within this share of the nominal motion, plus `PLAY_MM`.

A step that differs more from the mean motion is no slip: the belt has stopped or changed its speed."""
_UNKNOWN_SHARE = 0.5  # σ of steps without links if the belt stopped or changed its speed, as a share of the step


class MotionArrays(NamedTuple):
    """A `Motion` in the form that compiled functions take."""

    angle: Floats
    shift: Floats
    pivot: Floats


@dataclass(frozen=True, eq=False)
class Motion:
    """The position of the board in each of m rows: rotation and shift from row to tester coordinates."""

    angle: Floats  # (m,) rotation φ_j of each row, rad
    shift: Floats  # (m, 2) shift s_j of each row, mm
    pivot: Floats  # (2,) centre c of the rotations, mm

    def board(self, row: np.ndarray, ground_mm: Floats) -> Floats:
        """Transform ground points (k, 2), mm, seen in rows (k,), to points (k, 2) in tester coordinates."""
        return _moved(
            np.ascontiguousarray(row), np.ascontiguousarray(ground_mm), self.angle, self.pivot, self.pivot + self.shift
        )

    def turned(self, row: np.ndarray, arrow: Floats) -> Floats:
        """Rotate directions (k, 2) from the coordinates of rows (k,) to tester coordinates."""
        origin, rows = np.zeros_like(self.shift), np.ascontiguousarray(row)
        return _moved(rows, np.ascontiguousarray(arrow), self.angle, np.zeros(2), origin)

    def row_from_tester(self, row: int) -> Euclidean:
        """Return D_j of a row j, the rigid transform from tester to row coordinates."""
        return Euclidean(self.rows_from_tester[row], System.ROW, System.TESTER)

    @cached_property
    def rows_from_tester(self) -> Floats:
        """The matrices D_j of all rows, (m, 3, 3)."""
        c, s, nil = np.cos(self.angle), np.sin(self.angle), np.zeros(len(self.angle))
        x, y = (self.pivot + self.shift).T
        px, py = self.pivot
        rows = [(c, s, px - c * x - s * y), (-s, c, py + s * x - c * y), (nil, nil, nil + 1)]
        return np.ascontiguousarray(np.moveaxis(np.array(rows), 2, 0))

    @property
    def arrays(self) -> MotionArrays:
        """The motion as compiled functions take it."""
        return MotionArrays(self.angle, self.shift, self.pivot)


class RowStep(NamedTuple):
    """The motion of the board from row p to row q, as links of these rows show it: a turn, and one point in both rows.

    The point is the weighted mean of the links. There, errors of shift and turn are uncorrelated.
    """

    p: int
    q: int
    a_mm: complex  # the point on the ground of row p, as x + i·y
    b_mm: complex  # the same point on the ground of row q
    turn: float  # φ_q − φ_p, rad
    weight: float  # inverse variance of the point per axis, mm⁻²
    turn_weight: float  # inverse variance of the turn, rad⁻²
    floor_mm: float  # how much links scatter per axis beyond their noise
    px_per_mm: float


_ROUNDS, _SETTLED_MM = 8, 1e-4
"""The motion of a step is estimated again with new robust weights until it changes by less than this, or this often."""
_MEDIAN = 2 * math.log(2)  # median of the χ² distribution with two degrees of freedom
_KNEE, _CUT = 2.0, 6.0
"""Links beyond `_KNEE` standard deviations lose weight (Huber); beyond `_CUT` they have no weight."""
_LEAST_PX, _FEW, _FEW_PX = 0.003, 20, 0.05
"""Least scatter per axis beyond the noise: generally, and where less than `_FEW` links show it."""


def measure_step(
    p: int, q: int, a_mm: Floats, b_mm: Floats, noise_mm2: Floats, px_per_mm: Floats, overlap: Floats
) -> RowStep:
    """Estimate the motion from row p to row q from k ≥ 1 links; see `LinkArrays` for their columns."""
    median_mm = np.median(b_mm - a_mm, axis=0)
    a, b = (np.ascontiguousarray(v).view(np.complex128)[:, 0] for v in (a_mm, b_mm))
    middle, resolution = len(a) // 2, float(px_per_mm.mean())
    variance = (noise_mm2[:, 0, 0] + noise_mm2[:, 1, 1]) / 2
    noise = float(np.partition(variance, middle)[middle])
    least = ((_LEAST_PX if len(a) >= _FEW else _FEW_PX) / resolution) ** 2
    off, turn = a - b + complex(*median_mm), 0.0
    for _ in range(_ROUNDS):
        square = off.real**2 + off.imag**2
        floor = max(float(np.partition(square, middle)[middle]) / _MEDIAN - noise, least)
        sigma2 = variance + floor
        chi2 = square / (2 * sigma2)
        weight = np.where(chi2 <= _CUT**2, np.minimum(_KNEE / np.sqrt(np.maximum(chi2, 1e-9)), 1.0), 0.0) / (
            sigma2 * overlap
        )
        whole = float(weight.sum())
        about = complex(weight @ a) / whole, complex(weight @ b) / whole
        of_a, of_b = a - about[0], b - about[1]
        weighted = weight * of_b.conj()
        cross, spread = complex(weighted @ of_a), float((weighted @ of_b).real)
        turn = math.atan2(cross.imag, cross.real + 1 / YAW_RAD**2)
        before, off = off, of_a - cmath.exp(1j * turn) * of_b
        if float(np.abs(off - before).max()) < _SETTLED_MM:
            break
    return RowStep(p, q, *about, turn, whole, spread, math.sqrt(floor), resolution)


@compiled
def _moved(row: Ints, ground_mm: Floats, angle: Floats, pivot: Floats, to: Floats) -> Floats:
    """Rotate points (k, 2) of rows (k,) about a pivot (2,), which moves to the point `to[j]` in row j."""
    out, cos, sin = np.empty((len(row), 2)), np.cos(angle), np.sin(angle)
    for n in range(len(row)):
        j, x, y = row[n], ground_mm[n, 0] - pivot[0], ground_mm[n, 1] - pivot[1]
        out[n, 0], out[n, 1] = cos[j] * x - sin[j] * y + to[j, 0], sin[j] * x + cos[j] * y + to[j, 1]
    return out


def nominal_motion(times_s: Floats, velocity_mm_s: Floats, pivot_mm: Floats) -> Motion:
    """Return the motion of a board on a belt with nominal velocity (2,), at the times (m,) of the rows."""
    elapsed = np.asarray(times_s) - times_s[0]
    return Motion(np.zeros(len(elapsed)), -elapsed[:, None] * np.asarray(velocity_mm_s), np.asarray(pivot_mm))


def measured_velocity(motion: Motion, times_s: Floats, rows: np.ndarray) -> Floats | None:
    """Return the mean velocity (2,) mm/s of the belt between the outer ones of linked rows; None for a single row."""
    if len(rows) < 2:
        return None
    first, last = int(rows.min()), int(rows.max())
    return np.asarray(-(motion.shift[last] - motion.shift[first]) / (times_s[last] - times_s[first]))


def belt_equations(
    motion: Motion, times_s: Floats, velocity_mm_s: Floats, linked: np.ndarray
) -> tuple[Ints, Floats, Floats]:
    """Return the prior of the belt's motion as whitened equations, three per pair of consecutive rows.

    They are those of the motion along the belt, across it, and of the rotation. The belt moves at its measured mean
    velocity, which determines the position of rows without links. Where links show that it stopped or changed its
    speed, the prior predicts the step that they show, because the mean speed would pull the step away from it, and
    steps without links may have almost any speed.

    Args:
        motion: the current motion of the m rows.
        velocity_mm_s: (2,) nominal velocity of the belt.
        linked: (m − 1,) whether links connect rows across each step.

    Returns:
        Columns (m − 1, 6) of the unknowns, coefficients (m − 1, 3, 6), constant terms (m − 1, 3).
    """
    m, dt, steps_mm = len(motion.angle), times_s[1:] - times_s[:-1], motion.shift[:-1] - motion.shift[1:]
    # Weighted mean of the measured steps and of the nominal speed, each with its own variance.
    prior = STEP_TOLERANCE**2 / SPEED_TOLERANCE**2
    velocity = ((steps_mm[linked] / dt[linked, None]).sum(0) + prior * velocity_mm_s) / (linked.sum() + prior)
    speed = max(float(np.hypot(*velocity)), 1e-9)
    along = velocity / speed
    expected_mm = np.abs(dt) * speed
    sigma, residual = np.empty((m - 1, 3)), np.empty((m - 1, 3))
    sigma[:, 0], sigma[:, 1], sigma[:, 2] = STEP_TOLERANCE * expected_mm + 0.01, SWAY_MM, YAW_RAD
    frame = np.array([along, (-along[1], along[0])])
    residual[:, :2] = (dt[:, None] * velocity - steps_mm) @ frame.T
    residual[:, 2] = motion.angle[1:] - motion.angle[:-1]
    irregular = linked & (np.abs(residual[:, 0]) > SLIP_SHARE * expected_mm + PLAY_MM)
    if irregular.any():
        residual[irregular, 0] = 0.0
        sigma[~linked, 0] = _UNKNOWN_SHARE * expected_mm[~linked] + PLAY_MM
    both = np.zeros((3, 6))
    both[:2, 4:], both[2, 3] = frame, 1
    both[:, :3] = -both[:, 3:]
    return 3 * np.arange(m - 1)[:, None] + np.arange(6), both / sigma[:, :, None], residual / sigma
