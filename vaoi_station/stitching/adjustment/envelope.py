"""Store, solve and invert normal equations within the envelope of their matrix.

A row of a run shares observations with nearby rows only. Only the lower triangle of the normal matrix is stored. The
three lines of a row begin at the columns of the first row with which it shares an observation; entries before that are
0 and are not stored. The stored part is the envelope. C and the surface share observations with all rows and stand
last. The Cholesky factor has the same envelope. The entries of the inverse inside the envelope follow from the factor
by Takahashi's recursion (Erisman and Tinney, On computing certain elements of the inverse of a sparse matrix,
Communications of the ACM 18, 1975). Time and memory grow linearly with the number of rows; with a full matrix they
would grow with its cube and square.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.problem import Ints

_MIN_PIVOT = 1e-14
"""An unknown is unobserved if its pivot, divided by its diagonal entry before elimination, is below this."""


class NormalEquations(NamedTuple):
    """The normal equations (n, n) in the form that compiled functions take: the stored entries and the right-hand side.

    Only the lower triangle is stored, and of each line only the entries from the first one that can differ from 0
    (envelope).
    """

    first: Ints
    """(n,) the first stored column of each line of the matrix."""
    at: Ints
    """(n,) index of column 0 of each line in `values`: entry (i, j) is `values[at[i] + j]`."""
    values: Floats
    """The entries inside the envelope; after `factorise`, those of the Cholesky factor."""
    right: Floats
    """(n,) the right-hand side of the equations."""


@dataclass(frozen=True, eq=False)
class Envelope:
    """Which entries of a lower triangular matrix (n, n) are stored, and where: entry (i, j) is `values[at[i] + j]`."""

    first: Ints
    """Which entries of a lower triangular matrix (n, n) are stored, and where: entry (i, j) is `values[at[i] + j]`."""
    at: Ints
    """(n,) for each line, the index in the stored values minus the column; it is the same for all entries of the
    line."""
    rows: int
    """The number of rows of the run. The first 3·rows unknowns are their (φ, sx, sy). The other unknowns are coupled to
    all rows and stand last."""

    @staticmethod
    def of(furthest: Ints, others: int) -> Envelope:
        """Build the envelope of m rows and a number of other unknowns.

        `furthest` (m,) is the last row with which each row shares an observation, or the row itself.
        """
        m = len(furthest)
        lowest = np.arange(m)
        for row, last in enumerate(furthest.tolist()):
            lowest[row : last + 1] = np.minimum(lowest[row : last + 1], row)
        first = np.append(np.repeat(3 * lowest, 3), np.zeros(others, dtype=np.int_))
        lengths = np.arange(1, len(first) + 1) - first
        return Envelope(first, np.cumsum(lengths) - lengths - first, m)

    @property
    def size(self) -> int:
        """The number n of unknowns."""
        return len(self.first)

    @property
    def entries(self) -> int:
        """The number of matrix entries that lie inside the envelope."""
        return int(self.at[-1]) + self.size

    def zeros(self) -> NormalEquations:
        """Return normal equations with this envelope and without any observation: all values are 0."""
        return NormalEquations(self.first, self.at, np.zeros(self.entries), np.zeros(self.size))

    def dense(self, values: Floats) -> Floats:
        """Return the full symmetric matrix (n, n) whose lower triangle has these stored values."""
        out = np.zeros((self.size, self.size))
        for i, (first, at) in enumerate(zip(self.first.tolist(), self.at.tolist(), strict=True)):
            out[i, first : i + 1] = out[first : i + 1, i] = values[at + first : at + i + 1]
        return out


@compiled
def add_equations(columns: Ints, a: Floats, b: Floats, normal: NormalEquations) -> None:
    """Add k sets of whitened equations a·δ + b ≈ 0 to normal equations; δ are the changes of the unknowns.

    Args:
        columns: (k, f) indices of the f unknowns of each set. Within a set they are all different.
        a: (k, r, f) coefficients of the r equations of each set.
        b: (k, r) constant terms.
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


@compiled
def hold_first_row(normal: NormalEquations) -> None:
    """Fix the gauge: replace the lines and columns of row 0 by those of the identity, so that row 0 does not move."""
    first, at, values = normal.first, normal.at, normal.values
    for i in range(len(first)):
        for j in range(first[i], min(i + 1, 3)):
            values[at[i] + j] = 1.0 if i == j else 0.0
    normal.right[:3] = 0.0


@compiled
def factorise(normal: NormalEquations) -> None:
    """Replace a normal matrix, in place, by its Cholesky factor L. L is lower triangular, and L·Lᵀ is the matrix."""
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


def trailing_lines(envelope: Envelope, count: int) -> Ints:
    """Return the indices (count, count), in the stored values, of the block of the last `count` unknowns.

    The entries above the diagonal are not stored: their indices are those of the mirrored entries.
    """
    n = envelope.size
    i, j = np.meshgrid(np.arange(n - count, n), np.arange(n - count, n), indexing="ij")
    return np.asarray(envelope.at[np.maximum(i, j)] + np.minimum(i, j))


@compiled
def inverse(factor: NormalEquations, rows: int) -> Floats:
    """Return those entries of the inverse normal matrix that are inside the envelope, stored like the factor.

    `factor` holds the factorised normal equations of a run with `rows` rows.
    """
    first, at, values = factor.first, factor.at, factor.values
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


def row_blocks(envelope: Envelope, values: Floats) -> Floats:
    """Return one block (u, u) per row of a symmetric matrix that is stored in an envelope: (m, u, u) for m rows.

    The u unknowns of a block are the three of the row, followed by those that all rows share.
    """
    own = 3 * np.arange(envelope.rows)[:, None] + np.arange(3)
    others = np.broadcast_to(
        np.arange(3 * envelope.rows, envelope.size), (envelope.rows, envelope.size - 3 * envelope.rows)
    )
    at = np.concatenate([own, others], 1)
    i, j = np.maximum(at[:, :, None], at[:, None, :]), np.minimum(at[:, :, None], at[:, None, :])
    return np.asarray(values[envelope.at[i] + j])
