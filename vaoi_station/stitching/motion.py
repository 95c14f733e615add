"""The board's motion over the rows, and what is known of it beforehand.

Row j carries the board's place by `D_j`; what is estimated is its inverse, written about the middle
of the array so that angle and shift hardly depend on one another:

    board = R(φ_j)·(x − c) + c + s_j        for a point x of the conveyor's plane in row j
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vaoi_station.geometry import Euclidean, System
from vaoi_station.geometry.transforms import Floats

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
        return np.asarray(self.turned(row, ground_mm - self.pivot) + self.pivot + self.shift[row], dtype=np.float64)

    def turned(self, row: np.ndarray, arrow: Floats) -> Floats:
        """Directions (k, 2) turned as the board's coordinates are."""
        c, s = np.cos(self.angle[row]), np.sin(self.angle[row])
        return np.stack([c * arrow[:, 0] - s * arrow[:, 1], s * arrow[:, 0] + c * arrow[:, 1]], -1)

    def row_from_tester(self, row: int) -> Euclidean:
        """The paper's D_j."""
        return self._rows[row]

    @cached_property
    def _rows(self) -> tuple[Euclidean, ...]:
        c, s = np.cos(self.angle), np.sin(self.angle)
        x, y = (self.pivot + self.shift).T
        px, py = self.pivot
        shifts = np.stack([px - c * x - s * y, py + s * x - c * y], -1)
        turned = zip(self.angle, shifts, strict=True)
        return tuple(Euclidean.motion(-float(a), t, System.ROW, System.TESTER) for a, t in turned)

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
