"""Normal equations of rows that follow one another: kept, solved and inverted within the envelope of their matrix.

A row of the board shares observations with rows nearby only, so that its lines of the lower normal matrix begin at
the first row with which it shares one; C and the surface share some with all rows and stand last. Cholesky's factor
has the same envelope, and the entries of the inverse inside it follow from the factor by Takahashi's recursion (Erisman
and Tinney, On computing certain elements of the inverse of a sparse matrix, Communications of the ACM 18, 1975). So
time and memory grow with the rows, not with their cube and square.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.observations import Ints

_LEAST_PIVOT = 1e-14
"""Of a diagonal entry, what elimination must leave of it; with less an unknown is taken to be as unsure as that."""


@dataclass(frozen=True, eq=False)
class Envelope:
    """Which entries of a lower triangular matrix (n, n) are kept: entry (i, j) is `values[at[i] + j]`."""

    first: Ints
    """(n,) the first column of each line."""
    at: Ints
    """(n,) where its column 0 would stand."""
    rows: int
    """The first 3·rows unknowns are (φ, sx, sy) of the rows; n − 3·rows others, which go with all, stand last."""

    @staticmethod
    def of(furthest: Ints, others: int) -> Envelope:
        """By the last row (m,) with which each row shares an observation; itself if there is none after it."""
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
        """How many values are kept."""
        return int(self.at[-1]) + self.size

    def dense(self, values: Floats) -> Floats:
        """The symmetric matrix (n, n) of which these are the lower entries."""
        out = np.zeros((self.size, self.size))
        for i, (first, at) in enumerate(zip(self.first.tolist(), self.at.tolist(), strict=True)):
            out[i, first : i + 1] = out[first : i + 1, i] = values[at + first : at + i + 1]
        return out


@compiled
def add(columns: Ints, a: Floats, b: Floats, at: Ints, values: Floats, right: Floats) -> None:
    """Add whitened equations a·δ + b ≈ 0 to the normal equations.

    Args:
        columns: (k, f) numbers of the unknowns of each set, all different.
        a: (k, r, f).
        b: (k, r).
        at: of the envelope.
        values: in and out, of the envelope.
        right: in and out, (n,).
    """
    for k in range(len(a)):
        for r in range(a.shape[1]):
            for i in range(a.shape[2]):
                row = columns[k, i]
                right[row] -= a[k, r, i] * b[k, r]
                for j in range(a.shape[2]):
                    if columns[k, j] <= row:
                        values[at[row] + columns[k, j]] += a[k, r, i] * a[k, r, j]


@compiled
def hold_first_row(first: Ints, at: Ints, values: Floats, right: Floats) -> None:
    """Row 0 does not move: its lines become those of the identity."""
    for i in range(len(first)):
        for j in range(first[i], min(i + 1, 3)):
            values[at[i] + j] = 1.0 if i == j else 0.0
    right[:3] = 0.0


@compiled
def factor(first: Ints, at: Ints, values: Floats) -> None:
    """Put Cholesky's factor L, L·Lᵀ being the matrix, in its place."""
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
        values[at[i] + i] = math.sqrt(max(rest, _LEAST_PIVOT * whole))


@compiled
def solve(first: Ints, at: Ints, values: Floats, right: Floats) -> Floats:
    """The solution (n,) by a factor."""
    out = right.copy()
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
def inverse(first: Ints, at: Ints, rows: int, values: Floats) -> Floats:
    """The entries of the inverse inside the envelope, by a factor; the others begin after the rows."""
    out = np.zeros_like(values)
    below = np.zeros(len(first), np.int64)
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


def of_rows(envelope: Envelope, values: Floats) -> Floats:
    """The parts (m, u, u) of a symmetric matrix for the three unknowns of each row and the others together."""
    own = 3 * np.arange(envelope.rows)[:, None] + np.arange(3)
    others = np.broadcast_to(
        np.arange(3 * envelope.rows, envelope.size), (envelope.rows, envelope.size - 3 * envelope.rows)
    )
    at = np.concatenate([own, others], 1)
    i, j = np.maximum(at[:, :, None], at[:, None, :]), np.minimum(at[:, :, None], at[:, None, :])
    return np.asarray(values[envelope.at[i] + j])
