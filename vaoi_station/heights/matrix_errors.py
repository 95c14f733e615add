"""Combine the equations of a height with the errors of the matrices: the standard deviation of every height.

The pictures of a body do not meet exactly at any height, because the matrices of their frames are not exact, and
neither are lenses, interpolation and light. Parallax has one direction, these errors have two. So their size σ is
estimated from all bodies of the run together (restricted maximum likelihood), and for each body again with that as the
prior. The rows' own standard deviation limits σ from below, because the errors of a row have the direction of the belt,
which is that of the parallax.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats

_SIZES_PX = np.geomspace(0.004, 0.4, 21)
_WORST = -8.0
"""Least logarithm of the likelihood that one body contributes: a wrong one must not decide for all."""
_OWN = 0.5
"""Standard deviation of the logarithm of a body's own σ."""
_ROW_SHARE = 0.5
"""Share of the rows' standard deviation that two frames of one place do not have in common."""
_SCATTER_MM, _SCALE = 0.006, 0.002
"""Standard deviation of a body's shape, mm, and relative one of the working distance: 1 mm at 483 mm."""


class BodyEquations(NamedTuple):
    """Normal equations of a body for the error δ of its height and the displacement of each of its k pictures."""

    height_mm: float
    """The height at which the equations were linearised."""
    step_mm: float
    """First estimate of δ."""
    matrix: Floats
    """(1 + 2·k, 1 + 2·k)."""
    vector: Floats
    """(1 + 2·k,)."""
    scale: float
    """Pixels of a frame per pixel of the pictures."""
    unlike_mm: float = 0.0
    """Standard deviation by differences that all tiles have in common, such as glare."""


def combine(bodies: Mapping[str, BodyEquations], row_sigma_px: float) -> dict[str, tuple[float, float]]:
    """Return height and standard deviation of every body, mm.

    Args:
        bodies: the equations of all bodies of one run, by address.
        row_sigma_px: standard deviation of the rows' positions.
    """
    if not bodies:
        return {}
    tables = {ref: solve_at_sizes(b.matrix, b.vector, b.scale, _SIZES_PX)[:, 0] for ref, b in bodies.items()}
    tables = {address: table - table.max() for address, table in tables.items()}
    together = np.sum([np.maximum(table, _WORST) for table in tables.values()], axis=0)
    common = float(_SIZES_PX[int(np.argmax(together))])
    least = max(common, _ROW_SHARE * row_sigma_px)
    out = {}
    for address, body in bodies.items():
        own = tables[address] - (np.log(_SIZES_PX / least) / _OWN) ** 2 / 2
        size = max(float(_SIZES_PX[int(np.argmax(own))]), least)
        _, step_mm, own_variance = solve_at_sizes(body.matrix, body.vector, body.scale, np.array([size]))[0].tolist()
        # The equations belong to the height before the last step.
        mm = body.height_mm + step_mm
        variance = own_variance + body.unlike_mm**2 + _SCATTER_MM**2 + (_SCALE * mm) ** 2
        out[address] = mm, math.sqrt(variance)
    return out


@compiled
def solve_at_sizes(matrix: Floats, vector: Floats, scale: float, sizes_px: Floats) -> Floats:
    """Solve the equations of a body for n sizes of the displacements: their standard deviation is the prior.

    Returns (n, 3): the logarithm of the likelihood of the size, up to a constant, the height and its variance. The
    likelihood of a size for which the matrix is not positive definite is negligible.
    """
    m, n = len(vector), len(sizes_px)
    factor, right, out = np.empty((m, m)), np.empty(m), np.empty((n, 3))
    for s in range(n):
        added, log, fit, sound = (scale / sizes_px[s]) ** 2, 0.0, 0.0, True
        # Cholesky's elimination from the last unknown to the first, so that the last pivot is that of the height.
        for i in range(m - 1, -1, -1):
            for j in range(i, -1, -1):
                entry = matrix[i, j]
                if i == j:
                    entry += added if i else 1e-9
                for k in range(i + 1, m):
                    entry -= factor[k, i] * factor[k, j]
                if i == j:
                    sound = sound and entry > 0
                    factor[i, i] = math.sqrt(entry) if entry > 0 else 1.0
                else:
                    factor[i, j] = entry / factor[i, i]
            right[i] = vector[i]
            for k in range(i + 1, m):
                right[i] -= factor[k, i] * right[k]
            right[i] /= factor[i, i]
            log += 2 * math.log(factor[i, i])
            fit += right[i] ** 2
        out[s, 0] = (fit - log) / 2 - (m - 1) * math.log(sizes_px[s] / scale) if sound else -1e9
        out[s, 1], out[s, 2] = right[0] / factor[0, 0], 1 / factor[0, 0] ** 2
    return out
