"""The motion of the board over the rows, and its priors.

D_j moves the board from row 0 to row j. The adjustment estimates the inverse of D_j, as a rotation by φ_j about the
centre c of the camera array and a shift s_j. With this centre, angle and shift are nearly uncorrelated:

    board = R(φ_j)·(x − c) + c + s_j        for a point x of the conveyor's plane in row j
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry import Euclidean, System
from vaoi_station.geometry.transforms import Floats

Ints = NDArray[np.int_]

SPEED_TOLERANCE = 0.05
"""Standard deviation of the belt's mean speed, as a share of its nominal speed."""
STEP_TOLERANCE = 0.02
"""Standard deviation of the speed in one step between two rows, as a share of the mean speed."""
SWAY_MM = 0.15
"""Standard deviation of the motion across the belt between two rows."""
YAW_RAD = 0.003
"""Standard deviation of the rotation between two rows."""
SLIP_SHARE, PLAY_MM = 0.15, 1.0
"""Links are first searched within this share of the nominal motion, plus `PLAY_MM`.

A step that differs more from the mean motion is no slip: the belt has stopped or changed its speed."""
_UNKNOWN_SHARE = 0.5
"""Standard deviation of steps without links if the belt stopped or changed its speed, as a share of the step."""


@dataclass(frozen=True, eq=False)
class Motion:
    """The position of the board in each of m rows: rotation and shift from row to tester coordinates."""

    angle: Floats
    """(m,) rotation φ_j of each row, rad."""
    shift: Floats
    """(m, 2) shift s_j of each row, mm."""
    pivot: Floats
    """(2,) centre c of the rotations, mm."""

    def board(self, row: np.ndarray, ground_mm: Floats) -> Floats:
        """Transform ground points (k, 2), mm, seen in rows (k,), to points (k, 2) in tester coordinates."""
        return _moved(row, np.ascontiguousarray(ground_mm), self.angle, self.pivot, self.pivot + self.shift)

    def turned(self, row: np.ndarray, arrow: Floats) -> Floats:
        """Rotate directions (k, 2) from the coordinates of rows (k,) to tester coordinates."""
        return _moved(row, np.ascontiguousarray(arrow), self.angle, np.zeros(2), np.zeros_like(self.shift))

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

    def in_gauge(self) -> Motion:
        """Return the same motion in the gauge of results, in which D_0 is the identity."""
        if self.angle[0] == 0 and not self.shift[0].any():
            return self
        first = self.row_from_tester(0)
        angle = self.angle - self.angle[0]
        places = [first(self.pivot + self.shift[j]) - self.pivot for j in range(len(angle))]
        return replace(self, angle=angle, shift=np.array(places))


def nominal_motion(times_s: Floats, velocity_mm_s: Floats, pivot_mm: Floats) -> Motion:
    """Return the motion of a board on a belt with nominal velocity (2,), at the times (m,) of the rows."""
    elapsed = np.asarray(times_s) - times_s[0]
    return Motion(np.zeros(len(elapsed)), -elapsed[:, None] * np.asarray(velocity_mm_s), np.asarray(pivot_mm))


def measured_velocity(motion: Motion, times_s: Floats, rows: np.ndarray) -> Floats | None:
    """Return the mean velocity (2,) mm/s of the belt from the first to the last of the given rows.

    Links must connect these rows. Return None for fewer than two rows.
    """
    if len(rows) < 2:
        return None
    first, last = int(rows.min()), int(rows.max())
    return np.asarray(-(motion.shift[last] - motion.shift[first]) / (times_s[last] - times_s[first]))


def belt_equations(motion: Motion, times_s: Floats, velocity_mm_s: Floats) -> tuple[Ints, Floats, Floats]:
    """Return the prior of the belt's motion as whitened equations a·δ + b ≈ 0, one set per pair of consecutive rows.

    The three equations of a set are those of the motion along the belt, across it, and of the rotation.

    Args:
        motion: the current motion of the m rows, to which δ is a change.
        velocity_mm_s: (2,) velocity from which the steps are predicted.

    Returns:
        Columns (m − 1, 6) of the unknowns, coefficients a (m − 1, 3, 6), constant terms b (m − 1, 3).
    """
    m = len(motion.angle)
    dt = np.diff(times_s)
    speed = max(float(np.hypot(*velocity_mm_s)), 1e-9)
    along = velocity_mm_s / speed
    sigma = np.stack([STEP_TOLERANCE * np.abs(dt) * speed + 0.01, np.full(m - 1, SWAY_MM), np.full(m - 1, YAW_RAD)], -1)
    # residuals along and across the belt, which have different tolerances
    frame = np.array([along, (-along[1], along[0])])
    residual = (np.diff(motion.shift, axis=0) + dt[:, None] * velocity_mm_s) @ frame.T
    residual = np.concatenate([residual, np.diff(motion.angle)[:, None]], 1) / sigma
    step = np.zeros((3, 3))
    step[:2, 1:], step[2, 0] = frame, 1
    both = np.concatenate([-step, step], 1)
    return 3 * np.arange(m - 1)[:, None] + np.arange(6), both / sigma[:, :, None], residual


def let_irregular_steps_free(rest: Floats, slopes: Floats, step_mm: Floats, linked: np.ndarray) -> None:
    """Change the equations of `belt_equations` in place where links show that the belt stopped or changed its speed.

    The prior of such a step is changed to predict the step that the links show, because the mean speed would pull the
    step away from it. Steps without links may then have almost any speed. The equations of a belt that only slips are
    not changed.

    Args:
        rest: (m − 1, 3) constant terms.
        slopes: (m − 1, 3, 6) coefficients.
        step_mm: (m − 1,) length of each step at the predicted velocity.
        linked: (m − 1,) whether links connect rows across each step.
    """
    sigma_mm = STEP_TOLERANCE * np.abs(step_mm) + 0.01
    irregular = linked & (np.abs(rest[:, 0]) * sigma_mm > SLIP_SHARE * np.abs(step_mm) + PLAY_MM)
    if not irregular.any():
        return
    rest[irregular, 0] = 0.0
    wider = sigma_mm[~linked] / (_UNKNOWN_SHARE * np.abs(step_mm[~linked]) + PLAY_MM)
    rest[~linked, 0] *= wider
    slopes[~linked, 0] *= wider[:, None]


@compiled
def _moved(row: Ints, ground_mm: Floats, angle: Floats, pivot: Floats, to: Floats) -> Floats:
    """Rotate points (k, 2) of rows (k,) about a pivot (2,) by the angle of the row, and add a shift.

    The shift moves the pivot to the point `to[j]` in row j. `angle` is (m,) and `to` is (m, 2).
    """
    out, cos, sin = np.empty((len(row), 2)), np.cos(angle), np.sin(angle)
    for n in range(len(row)):
        j, x, y = row[n], ground_mm[n, 0] - pivot[0], ground_mm[n, 1] - pivot[1]
        out[n, 0], out[n, 1] = cos[j] * x - sin[j] * y + to[j, 0], sin[j] * x + cos[j] * y + to[j, 1]
    return out


@compiled
def points_in_box(rows: Floats, board_mm: Floats, low: Floats, high: Floats) -> tuple[Ints, Ints, Floats]:
    """Find in which rows which points of the board lie inside a box on the conveyor's plane.

    Args:
        board_mm: (k, 2) points of the board in tester coordinates.
        low: (2,) the corner of the box with the smallest x and y, in row coordinates.
        high: (2,) the corner with the largest x and y.

    Returns:
        For each of v hits, row by row: the row (v,), the index of the point (v,), its row coordinates (v, 2).
    """
    most = len(rows) * len(board_mm)
    row, point, place = np.empty(most, np.int64), np.empty(most, np.int64), np.empty((most, 2))
    count = 0
    for j in range(len(rows)):
        d = rows[j]
        for n in range(len(board_mm)):
            x = d[0, 0] * board_mm[n, 0] + d[0, 1] * board_mm[n, 1] + d[0, 2]
            y = d[1, 0] * board_mm[n, 0] + d[1, 1] * board_mm[n, 1] + d[1, 2]
            if low[0] <= x <= high[0] and low[1] <= y <= high[1]:
                row[count], point[count], place[count, 0], place[count, 1] = j, n, x, y
                count += 1
    return row[:count].copy(), point[:count].copy(), place[:count].copy()
