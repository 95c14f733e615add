"""Four normal equations, compiled: solved in place, without a call into a library for each."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import inlined


@inlined
def solve_cholesky(a: NDArray[np.float64], n: int) -> bool:
    """Cholesky on the upper triangle of the first n equations; the solution comes to column 4."""
    for i in range(n):
        largest = a[i, i]
        for k in range(i):
            a[i, i] -= a[k, i] * a[k, i]
        if not a[i, i] > 1e-9 * largest or largest <= 0:
            return False
        a[i, i] = math.sqrt(a[i, i])
        for j in range(i + 1, n):
            for k in range(i):
                a[i, j] -= a[k, i] * a[k, j]
            a[i, j] /= a[i, i]
    for i in range(n):
        for k in range(i):
            a[i, 4] -= a[k, i] * a[k, 4]
        a[i, 4] /= a[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            a[i, 4] -= a[i, k] * a[k, 4]
        a[i, 4] /= a[i, i]
    return True


@inlined
def position_variance(root: NDArray[np.float64]) -> float:
    """Mean variance of the first two unknowns, measurements having 1, from what `solve` left of four equations."""
    total = 0.0
    row = np.zeros(4)
    for i in range(2):
        for j in range(i, 4):  # row i of the factor's inverse
            row[j] = 1.0 if i == j else 0.0
            for k in range(i, j):
                row[j] -= row[k] * root[k, j]
            row[j] /= root[j, j]
            total += 0.5 * row[j] * row[j]
    return total
