"""Cholesky solution of up to four normal equations, compiled and in place.

A call of LAPACK for each of these small systems would take longer than the solution itself.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import inlined


@inlined
def solve_cholesky(a: NDArray[np.float64], n: int) -> bool:
    """Solve the first n normal equations in place. Return False if they are singular.

    The upper triangle of `a` (4, 5) becomes its Cholesky factor, and the right side in column 4 the solution.
    """
    for i in range(n):
        largest = a[i, i]
        for k in range(i):
            a[i, i] -= a[k, i] * a[k, i]
        # The remaining diagonal entry is the part of this unknown that the others do not explain. `not >` also catches
        # NaN.
        if not a[i, i] > 1e-9 * largest or largest <= 0:
            return False
        a[i, i] = math.sqrt(a[i, i])
        for j in range(i + 1, n):
            for k in range(i):
                a[i, j] -= a[k, i] * a[k, j]
            a[i, j] /= a[i, i]
    # Forward substitution, then back substitution.
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
    """Compute the mean variance of the first two unknowns, for unit variance, from the Cholesky factor (4, 4…)."""
    total = 0.0
    row = np.zeros(4)
    # The covariance is R⁻¹·R⁻ᵀ, so a variance is the square sum of one row of R⁻¹.
    for i in range(2):
        for j in range(i, 4):
            row[j] = 1.0 if i == j else 0.0
            for k in range(i, j):
                row[j] -= row[k] * root[k, j]
            row[j] /= root[j, j]
            total += 0.5 * row[j] * row[j]
    return total
