"""The board's motion over the rows, and what is known of it beforehand.

Row j carries the board's place by `D_j`; what is estimated is its inverse, written about the middle
of the array so that angle and shift hardly depend on one another:

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
"""How far the belt's mean speed may be from the nominal one (1 σ, relative)."""
STEP_TOLERANCE = 0.02
"""How far a single step may be from the mean speed (1 σ, relative)."""
SWAY_MM = 0.15
YAW_RAD = 0.003
"""How far a board slides and turns between two rows (1 σ)."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Where the board is at every row: angles (m,) rad, shifts (m, 2) mm, and the pivot c (2,) mm."""

    angle: Floats
    shift: Floats
    pivot: Floats

    def board(self, row: np.ndarray, ground_mm: Floats) -> Floats:
        """Board points (k, 2), in tester coordinates, of ground points (k, 2) seen in rows (k,)."""
        return _moved(row, np.ascontiguousarray(ground_mm), self.angle, self.pivot, self.pivot + self.shift)

    def turned(self, row: np.ndarray, arrow: Floats) -> Floats:
        """Directions (k, 2) turned as the board's coordinates are."""
        return _moved(row, np.ascontiguousarray(arrow), self.angle, np.zeros(2), np.zeros_like(self.shift))

    def row_from_tester(self, row: int) -> Euclidean:
        """The paper's D_j."""
        return Euclidean(self.rows_from_tester[row], System.ROW, System.TESTER)

    @cached_property
    def rows_from_tester(self) -> Floats:
        """All D_j, (m, 3, 3)."""
        c, s, nil = np.cos(self.angle), np.sin(self.angle), np.zeros(len(self.angle))
        x, y = (self.pivot + self.shift).T
        px, py = self.pivot
        rows = [(c, s, px - c * x - s * y), (-s, c, py + s * x - c * y), (nil, nil, nil + 1)]
        return np.ascontiguousarray(np.moveaxis(np.array(rows), 2, 0))

    def in_gauge(self) -> Motion:
        """The same motion with D_0 the identity (the convention of results)."""
        if self.angle[0] == 0 and not self.shift[0].any():
            return self
        first = self.row_from_tester(0)
        angle = self.angle - self.angle[0]
        places = [first(self.pivot + self.shift[j]) - self.pivot for j in range(len(angle))]
        return replace(self, angle=angle, shift=np.array(places))


def nominal_motion(times_s: Floats, velocity_mm_s: Floats, pivot_mm: Floats) -> Motion:
    """The belt running as it should."""
    elapsed = np.asarray(times_s) - times_s[0]
    return Motion(np.zeros(len(elapsed)), -elapsed[:, None] * np.asarray(velocity_mm_s), np.asarray(pivot_mm))


def measured_velocity(motion: Motion, times_s: Floats, rows: np.ndarray) -> Floats | None:
    """Mean velocity (2,) mm/s of the array's middle over rows that are tied to one another; None if fewer than two."""
    if len(rows) < 2:
        return None
    first, last = int(rows.min()), int(rows.max())
    return np.asarray(-(motion.shift[last] - motion.shift[first]) / (times_s[last] - times_s[first]))


@compiled
def _moved(row: Ints, ground_mm: Floats, angle: Floats, pivot: Floats, to: Floats) -> Floats:
    """Points (k, 2) turned about the pivot by the angle of their row, the pivot going where that row has it (m, 2)."""
    out, cos, sin = np.empty((len(row), 2)), np.cos(angle), np.sin(angle)
    for n in range(len(row)):
        j, x, y = row[n], ground_mm[n, 0] - pivot[0], ground_mm[n, 1] - pivot[1]
        out[n, 0], out[n, 1] = cos[j] * x - sin[j] * y + to[j, 0], sin[j] * x + cos[j] * y + to[j, 1]
    return out


@compiled
def points_in_box(rows: Floats, board_mm: Floats, low: Floats, high: Floats) -> tuple[Ints, Ints, Floats]:
    """Which points of the board come into a box, in which rows, and where they are then.

    Args:
        rows: (m, 3, 3) D_j.
        board_mm: (k, 2) tester coordinates.
        low: (2,) lowest corner of the box on the conveyor's plane.
        high: (2,) highest corner.

    Returns:
        Row (v,) and number of the point (v,), row by row, and the place (v, 2) in row coordinates.
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
