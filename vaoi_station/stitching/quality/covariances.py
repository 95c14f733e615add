"""Covariances of D_j and standard deviations of M_ij, in the form that results carry.

A row's three numbers are the turn φ of D_j (rad) and the place (mm, row coordinates) to which D_j takes the point of
the board that then lies under the pivot, a fixed point of the conveyor's plane in the middle of the array. A ground
point at x is then off by δ(x, y) + δφ·(−(x − c)_y, (x − c)_x), c being the pivot, and an image point by N_i's slope
times that. Row 0 has none: D_0 is the identity by definition.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.problem import AdjustmentResult


def row_covariances(adjusted: AdjustmentResult) -> Floats:
    """Compute the covariance of (φ, x, y) of every D_j at the pivot, (m, 3, 3) in rad and mm."""
    motion = adjusted.motion
    m = len(motion.angle)
    c, s = np.cos(motion.angle), np.sin(motion.angle)
    # The adjustment has the inverse, board = R(φ)·(x − c) + c + s. A shift of the board by δs is a shift of the ground
    # point by −R(−φ)·δs, and its turn is the opposite one.
    turn = np.zeros((m, 3, 3))
    turn[:, 0, 0] = -1
    turn[:, 1, 1], turn[:, 1, 2], turn[:, 2, 1], turn[:, 2, 2] = -c, -s, s, -c
    return np.asarray(turn @ adjusted.covariance[:, :3, :3] @ turn.swapaxes(1, 2))


def matrix_sigmas(cameras: Sequence[Camera], pivot_mm: Floats, rows: Floats) -> Floats:
    """Compute standard deviations (n, m, 2) px of every M_ij from the covariances (m, 3, 3) of the rows.

    They are those in the worst direction, at the middle of the frame and at its worst corner.
    """
    return np.array([_sigmas(camera, pivot_mm, rows) for camera in cameras])


def largest_sigma(covariance: Floats) -> Floats:
    """Compute the standard deviation (…) in the worst direction, for covariances (…, 2, 2)."""
    # The larger eigenvalue of a symmetric 2×2 matrix in closed form, for all of them at once.
    a, b, d = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    return np.asarray(np.sqrt(np.maximum((a + d) / 2 + np.hypot((a - d) / 2, b), 0)))


def _sigmas(camera: Camera, pivot_mm: Floats, rows: Floats) -> Floats:
    w, h = camera.width_px - 1.0, camera.height_px - 1.0
    ground = camera.ground(np.array([camera.center_px, (0, 0), (w, 0), (w, h), (0, h)]))
    arm = ground - pivot_mm
    by_row = np.zeros((5, 2, 3))
    by_row[:, 0, 0], by_row[:, 1, 0] = -arm[:, 1], arm[:, 0]
    by_row[:, 0, 1] = by_row[:, 1, 2] = 1
    j = _slope(camera, ground) @ by_row
    sigma = largest_sigma(j[None] @ rows[:, None] @ j.swapaxes(1, 2)[None])
    return np.stack([sigma[:, 0], sigma[:, 1:].max(1)], -1)


def _slope(camera: Camera, ground_mm: Floats) -> Floats:
    """Compute the derivative (k, 2, 2) of undistorted pixels by ground places (k, 2), px/mm."""
    n = camera.image_from_row.matrix
    homogeneous = np.column_stack([ground_mm, np.ones(len(ground_mm))]) @ n.T
    px = homogeneous[:, :2] / homogeneous[:, 2:]
    return np.asarray((n[None, :2, :2] - px[:, :, None] * n[None, 2:, :2]) / homogeneous[:, 2, None, None])
