"""Store, solve and invert normal equations within the envelope of their matrix.

A row of the board shares observations with nearby rows only. Its lines of the lower normal matrix therefore begin at
the first row with which it shares one. C and the surface share observations with all rows and stand last. The Cholesky
factor has the same envelope. The entries of the inverse inside it follow from the factor by Takahashi's recursion
(Erisman and Tinney, On computing certain elements of the inverse of a sparse matrix, Communications of the ACM 18,
1975). Time and memory grow linearly with the number of rows, not with its cube and square.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.observations import Ints

_MIN_PIVOT = 1e-14
"""Smallest share of a diagonal entry that elimination may leave; below it the unknown counts as unobserved."""


class NormalEquations(NamedTuple):
    """The lower triangle of a normal matrix (n, n) and its right-hand side, for compiled functions."""

    first: Ints
    """(n,) the first column of each line."""
    at: Ints
    """(n,) index of column 0 of each line: entry (i, j) is `values[at[i] + j]`."""
    values: Floats
    """The entries within the envelope; after `factorise` those of the Cholesky factor."""
    right: Floats
    """(n,)."""


@dataclass(frozen=True, eq=False)
class Envelope:
    """Which entries of a lower triangular matrix (n, n) are stored: entry (i, j) is `values[at[i] + j]`."""

    first: Ints
    """(n,) the first column of each line."""
    at: Ints
    """(n,) index of column 0 of each line, which may lie before the line's first stored entry."""
    rows: int
    """The first 3·rows unknowns are (φ, sx, sy) of the rows; the others are coupled to all rows and stand last."""

    @staticmethod
    def of(furthest: Ints, others: int) -> Envelope:
        """Build from the last row (m,) with which each row shares an observation; itself if there is none after it."""
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
        """The number of stored values."""
        return int(self.at[-1]) + self.size

    def zeros(self) -> NormalEquations:
        """Return normal equations without any observation."""
        return NormalEquations(self.first, self.at, np.zeros(self.entries), np.zeros(self.size))

    def dense(self, values: Floats) -> Floats:
        """Return the symmetric matrix (n, n) with these lower entries."""
        out = np.zeros((self.size, self.size))
        for i, (first, at) in enumerate(zip(self.first.tolist(), self.at.tolist(), strict=True)):
            out[i, first : i + 1] = out[first : i + 1, i] = values[at + first : at + i + 1]
        return out


@compiled
def add_equations(columns: Ints, a: Floats, b: Floats, normal: NormalEquations) -> None:
    """Add whitened equations a·δ + b ≈ 0 to normal equations.

    Args:
        columns: (k, f) indices of the unknowns of each set, all different.
        a: (k, r, f).
        b: (k, r).
        normal: changed in place.
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
    """Fix the gauge: replace the lines of row 0 by those of the identity, so that it does not move."""
    first, at, values = normal.first, normal.at, normal.values
    for i in range(len(first)):
        for j in range(first[i], min(i + 1, 3)):
            values[at[i] + j] = 1.0 if i == j else 0.0
    normal.right[:3] = 0.0


@compiled
def factorise(normal: NormalEquations) -> None:
    """Replace the matrix by its Cholesky factor L, where L·Lᵀ is the matrix."""
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
        # rounding can leave an unobserved unknown a pivot of 0 or less; a tiny one keeps it unknown and harms no other
        values[at[i] + i] = math.sqrt(max(rest, _MIN_PIVOT * whole))


@compiled
def solve(factor: NormalEquations) -> Floats:
    """Return the solution (n,) of factorised normal equations."""
    first, at, values = factor.first, factor.at, factor.values
    out = factor.right.copy()
    for i in range(len(first)):
        for k in range(first[i], i):
            out[i] -= values[at[i] + k] * out[k]
        out[i] /= values[at[i] + i]
    for i in range(len(first) - 1, -1, -1):
        out[i] /= values[at[i] + i]
        for k in range(first[i], i):
            out[k] -= values[at[i] + k] * out[i]
    return out


@compiled
def inverse(factor: NormalEquations, rows: int) -> Floats:
    """Return the entries of the inverse inside the envelope of factorised normal equations."""
    first, at, values = factor.first, factor.at, factor.values
    out = np.zeros_like(values)
    below = np.zeros(len(first), np.int64)
    # from the last column back: each entry needs those of later columns only
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
    """Return the blocks (m, u, u) of a symmetric matrix: the three unknowns of each row together with the others."""
    own = 3 * np.arange(envelope.rows)[:, None] + np.arange(3)
    others = np.broadcast_to(
        np.arange(3 * envelope.rows, envelope.size), (envelope.rows, envelope.size - 3 * envelope.rows)
    )
    at = np.concatenate([own, others], 1)
    i, j = np.maximum(at[:, :, None], at[:, None, :]), np.minimum(at[:, :, None], at[:, None, :])
    return np.asarray(values[envelope.at[i] + j])
