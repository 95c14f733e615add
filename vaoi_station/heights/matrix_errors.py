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
    tables = {address: _likelihoods(body) for address, body in bodies.items()}
    tables = {address: table - table.max() for address, table in tables.items()}
    together = np.sum([np.maximum(table, _WORST) for table in tables.values()], axis=0)
    common = float(_SIZES_PX[int(np.argmax(together))])
    least = max(common, _ROW_SHARE * row_sigma_px)
    out = {}
    for address, body in bodies.items():
        own = tables[address] - (np.log(_SIZES_PX / least) / _OWN) ** 2 / 2
        size = max(float(_SIZES_PX[int(np.argmax(own))]), least)
        covariance = np.linalg.inv(body.matrix + _prior(body, size))
        # The equations belong to the height before the last step.
        mm = body.height_mm + float((covariance @ body.vector)[0])
        variance = float(covariance[0, 0]) + body.unlike_mm**2 + _SCATTER_MM**2 + (_SCALE * mm) ** 2
        out[address] = mm, math.sqrt(variance)
    return out


def _prior(body: BodyEquations, size_px: float) -> Floats:
    """Return the information of a displacement's prior; the height has none."""
    return np.diag([1e-9] + [(body.scale / size_px) ** 2] * (len(body.vector) - 1))


def _likelihoods(body: BodyEquations) -> Floats:
    """Return the logarithm of the likelihood of every size of the displacements (`_SIZES_PX`), up to a constant.

    Prior information s is added to the displacements' block of the matrix. With the eigenvalues λ of this block, its
    determinant and its inverse follow for all s at once; the height is eliminated last (Schur complement).
    """
    own, turn = np.linalg.eigh(body.matrix[1:, 1:])
    mixed, right = body.matrix[0, 1:] @ turn, body.vector[1:] @ turn
    added = own + ((body.scale / _SIZES_PX) ** 2)[:, None]
    height = body.matrix[0, 0] + 1e-9 - (mixed**2 / added).sum(1)
    sound = (added > 0).all(1) & (height > 0)
    added, height = np.where(sound[:, None], added, 1.0), np.where(sound, height, 1.0)
    fit = (right**2 / added).sum(1) + (body.vector[0] - (mixed * right / added).sum(1)) ** 2 / height
    log = np.log(added).sum(1) + np.log(height)
    return np.where(sound, (fit - log) / 2 - len(own) * np.log(_SIZES_PX / body.scale), -1e9)
