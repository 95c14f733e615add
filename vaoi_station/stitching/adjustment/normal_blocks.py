"""Blocks of whitened equations, their sum as normal equations, and the prior of the belt in this form.

A block states a·δ + b ≈ 0, where δ are the changes of the unknowns in its columns. Every equation has unit variance.
The sum of aᵀa over all blocks is the normal matrix, and the sum of −aᵀb is the right-hand side. A block that relates
two rows has entries in the columns of these rows only.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.motion import STEP_TOLERANCE, SWAY_MM, YAW_RAD, Motion
from vaoi_station.stitching.adjustment.observations import Ints


@dataclass(frozen=True, eq=False)
class Block:
    """A block of n whitened equations a·δ + b ≈ 0 in f unknowns."""

    columns: Ints
    """(f,) indices of the unknowns; an index may occur twice."""
    a: Floats
    """(n, f) coefficients."""
    b: Floats
    """(n,) constant terms."""


def sum_blocks(blocks: Iterable[Block], size: int) -> tuple[Floats, Floats]:
    """Return the normal matrix (size, size) and the right-hand side (size,) of all blocks in `size` unknowns."""
    normal, right = np.zeros((size, size)), np.zeros(size)
    for block in blocks:
        twice = len(set(block.columns.tolist())) < len(block.columns)
        square, product = block.a.T @ block.a, block.a.T @ block.b
        # fancy indexing adds a repeated column only once; `np.add.at` adds it twice, but is slow
        if twice:
            np.add.at(normal, np.ix_(block.columns, block.columns), square)
            np.subtract.at(right, block.columns, product)
        else:
            normal[np.ix_(block.columns, block.columns)] += square
            right[block.columns] -= product
    return normal, right


def square_roots(information: Floats) -> Floats:
    """Return upper triangular matrices r (k, 2, 2) with rᵀ·r = information (k, 2, 2), which may be 0."""
    r = np.zeros_like(information)
    r[:, 0, 0] = np.sqrt(np.maximum(information[:, 0, 0], 0))
    r[:, 0, 1] = information[:, 0, 1] / np.maximum(r[:, 0, 0], 1e-150)
    r[:, 1, 1] = np.sqrt(np.maximum(information[:, 1, 1] - r[:, 0, 1] ** 2, 0))
    return r


def whiten(root: Floats, values: Floats) -> Floats:
    """Return the products root·values, component by component (2, k, …), for values (k, 2, …).

    `root` (k, 2, 2) are the results of `square_roots`.
    """
    more = (...,) + (None,) * (values.ndim - 2)
    first = root[:, 0, 0][more] * values[:, 0] + root[:, 0, 1][more] * values[:, 1]
    return np.stack([first, root[:, 1, 1][more] * values[:, 1]])


def belt_blocks(motion: Motion, times_s: Floats, velocity_mm_s: Floats) -> list[Block]:
    """Return the prior of the belt's motion as blocks, one for each pair of consecutive rows.

    The three equations of a block are those of the motion along the belt, across it, and of the rotation.
    """
    return [Block(*step) for step in zip(*belt_steps(motion, times_s, velocity_mm_s), strict=True)]


def belt_steps(motion: Motion, times_s: Floats, velocity_mm_s: Floats) -> tuple[Ints, Floats, Floats]:
    """Return the blocks of `belt_blocks` for m rows as arrays: columns (m − 1, 6), a (m − 1, 3, 6), b (m − 1, 3).

    `velocity_mm_s` (2,) is the velocity from which the steps are predicted.
    """
    m = len(motion.angle)
    dt = np.diff(times_s)
    speed = max(float(np.hypot(*velocity_mm_s)), 1e-9)
    along = velocity_mm_s / speed
    sigma = np.stack([STEP_TOLERANCE * np.abs(dt) * speed + 0.01, np.full(m - 1, SWAY_MM), np.full(m - 1, YAW_RAD)], -1)
    # residuals along and across the belt, which have different tolerances
    frame = np.array([along, (-along[1], along[0])])
    residual = (np.diff(motion.shift, axis=0) + dt[:, None] * velocity_mm_s) @ frame.T
    residual = np.concatenate([residual, np.diff(motion.angle)[:, None]], 1) / sigma
    step = np.zeros((3, 3))
    step[:2, 1:], step[2, 0] = frame, 1
    both = np.concatenate([-step, step], 1)
    return 3 * np.arange(m - 1)[:, None] + np.arange(6), both / sigma[:, :, None], residual
