"""Store, solve and invert normal equations within the envelope of their matrix.

A row of a run shares observations with nearby rows only, so the three lines of a row begin at the columns of the first
row with which it shares one; what is before that is 0 and not stored. C, the surface and the cameras share observations
with all rows and stand last. The Cholesky factor has the same envelope, and the entries of the inverse inside it follow
from the factor by Takahashi's recursion (Erisman and Tinney, On computing certain elements of the inverse of a sparse
matrix, Communications of the ACM 18, 1975). Time and memory grow linearly with the number of rows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.problem import Ints

_MIN_PIVOT = 1e-14
"""An unknown is unobserved if its pivot, divided by its diagonal entry before elimination, is below this."""


class NormalEquations(NamedTuple):
    """The normal equations (n, n): the lower triangle, of each line only from the first entry that can differ from 0.

    The first 3·rows unknowns are (φ, sx, sy) of each row. Entry (i, j) is `values[at[i] + j]`.
    """

    first: Ints  # (n,) the first stored column of each line
    at: Ints  # (n,) index of column 0 of each line in `values`
    values: Floats  # the entries inside the envelope; after `factorise`, those of the Cholesky factor
    right: Floats  # (n,) the right-hand side
    rows: int

    @staticmethod
    def of(furthest: Ints, others: int) -> NormalEquations:
        """Make equations without any observation.

        `furthest` (m,) is the last row with which each row shares an observation, or the row itself; `others` is the
        number of unknowns that are coupled to all rows.
        """
        rows = np.arange(len(furthest))
        # the first row of which an observation reaches as far as each row
        lowest = np.searchsorted(np.maximum.accumulate(furthest), rows)
        first = np.append(np.repeat(3 * lowest, 3), np.zeros(others, dtype=np.int_))
        lengths = np.arange(1, len(first) + 1) - first
        at = np.cumsum(lengths) - lengths - first
        return NormalEquations(first, at, np.zeros(int(lengths.sum())), np.zeros(len(first)), len(rows))

    def zeros(self) -> NormalEquations:
        """Return equations of the same envelope without any observation."""
        return self._replace(values=np.zeros_like(self.values), right=np.zeros_like(self.right))

    def copy(self) -> NormalEquations:
        """Return the same equations in arrays of their own."""
        return self._replace(values=self.values.copy(), right=self.right.copy())

    def less(self, part: NormalEquations) -> NormalEquations:
        """Return the equations without a part of their observations."""
        return self._replace(values=self.values - part.values, right=self.right - part.right)

    def add(self, part: NormalEquations) -> None:
        """Add equations of fewer rows, the first ones, and the same other unknowns."""
        line = np.repeat(np.arange(len(part.first)), np.arange(len(part.first)) + 1 - part.first)
        place = np.arange(len(part.first))
        place[3 * part.rows :] += 3 * (self.rows - part.rows)
        self.values[self.at[place[line]] + place[np.arange(len(line)) - part.at[line]]] += part.values
        self.right[place] += part.right

    def trailing(self, count: int) -> Ints:
        """Return the indices (count, count) in `values` of the block of the last unknowns, mirrored above its diagonal.

        After `factorise`, the lower triangle of this block is the factor of their reduced normal matrix.
        """
        own = np.arange(len(self.first) - count, len(self.first))
        return np.asarray(self.at[np.maximum.outer(own, own)] + np.minimum.outer(own, own))

    def row_blocks(self, values: Floats) -> Floats:
        """Return one block (u, u) per row, (m, u, u), of a symmetric matrix that is stored in this envelope.

        The u unknowns of a block are the three of the row, followed by those that all rows share.
        """
        own = 3 * np.arange(self.rows)[:, None] + np.arange(3)
        others = np.arange(3 * self.rows, len(self.first))
        at = np.concatenate([own, np.broadcast_to(others, (self.rows, len(others)))], 1)
        i, j = np.maximum(at[:, :, None], at[:, None, :]), np.minimum(at[:, :, None], at[:, None, :])
        return np.asarray(values[self.at[i] + j])


@compiled
def add_equations(columns: Ints, a: Floats, b: Floats, normal: NormalEquations) -> None:
    """Add k sets of r whitened equations a·δ + b ≈ 0 in f different unknowns to normal equations.

    `columns` (k, f) are the unknowns of each set, a (k, r, f) the coefficients, b (k, r) the constant terms.
    """
    at, values, right = normal.at, normal.values, normal.right
    for k in range(len(a)):
        for r in range(a.shape[1]):
            for i in range(a.shape[2]):
                row = columns[k, i]
                right[row] -= a[k, r, i] * b[k, r]
                for j in range(a.shape[2]):
                    if columns[k, j] <= row:
                        values[at[row] + columns[k, j]] += a[k, r, i] * a[k, r, j]


def hold_first_row(normal: NormalEquations) -> None:
    """Fix the gauge: replace the lines and columns of row 0 by those of the identity, so that row 0 does not move."""
    for j in range(3):
        below = j + np.flatnonzero(normal.first[j:] <= j)
        normal.values[normal.at[below] + j] = 0.0
        normal.values[normal.at[j] + normal.first[j] : normal.at[j] + j] = 0.0
        normal.values[normal.at[j] + j] = 1.0
    normal.right[:3] = 0.0


@compiled
def factorise(normal: NormalEquations) -> None:
    """Replace a normal matrix, in place, by its lower triangular Cholesky factor L: L·Lᵀ is the matrix."""
    first, at, values = normal.first, normal.at, normal.values
    for i in range(len(first)):
        for j in range(first[i], i):
            rest = values[at[i] + j]
            for k in range(max(first[i], first[j]), j):
                rest -= values[at[i] + k] * values[at[j] + k]
            values[at[i] + j] = rest / values[at[j] + j]
        whole = values[at[i] + i]
        rest = whole
        for k in range(first[i], i):
            rest -= values[at[i] + k] ** 2
        # Rounding can make the pivot of an unobserved unknown 0 or negative. With a tiny positive pivot instead, its
        # variance is huge, and the other unknowns are not affected.
        values[at[i] + i] = math.sqrt(max(rest, _MIN_PIVOT * whole))


@compiled
def solve_forward(factor: NormalEquations) -> Floats:
    """Return L⁻¹ times the right-hand side (n,), where L is the factor of the normal equations."""
    first, at, values = factor.first, factor.at, factor.values
    out = factor.right.copy()
    for i in range(len(first)):
        for k in range(first[i], i):
            out[i] -= values[at[i] + k] * out[k]
        out[i] /= values[at[i] + i]
    return out


@compiled
def solve_backward(factor: NormalEquations, forward: Floats) -> Floats:
    """Return the solution (n,) of factorised normal equations from the vector (n,) that `solve_forward` returns."""
    first, at, values = factor.first, factor.at, factor.values
    out = forward.copy()
    for i in range(len(first) - 1, -1, -1):
        out[i] /= values[at[i] + i]
        for k in range(first[i], i):
            out[k] -= values[at[i] + k] * out[i]
    return out


@compiled
def inverse(factor: NormalEquations) -> Floats:
    """Return those entries of the inverse normal matrix that are inside the envelope, stored like the factor."""
    first, at, values, rows = factor.first, factor.at, factor.values, factor.rows
    out = np.zeros_like(values)
    below = np.zeros(len(first), np.int64)
    # columns from last to first: an entry of the inverse depends on entries of later columns only
    for j in range(len(first) - 1, -1, -1):
        count = 0
        for i in range(j + 1, 3 * rows):
            if first[i] > j:
                break
            below[count] = i
            count += 1
        for i in range(max(j + 1, 3 * rows), len(first)):
            below[count] = i
            count += 1
        pivot = values[at[j] + j]
        own = 1 / pivot
        for n in range(count):
            i, total = below[n], 0.0
            for m in range(count):
                k = below[m]
                total += out[at[max(i, k)] + min(i, k)] * values[at[k] + j]
            out[at[i] + j] = -total / pivot
            own += total / pivot * values[at[i] + j]
        out[at[j] + j] = own / pivot
    return out
