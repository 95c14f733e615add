"""Covariances of D_j and standard deviations of M_ij, in the form in which results contain them.

The pivot c is a fixed point of the conveyor's plane in the middle of the array. Three numbers describe the motion of a
row: the turn φ of D_j (rad), and the position (x, y) (mm, row coordinates) of the board point that lies under the pivot
in that row. With errors δφ and δ(x, y), a ground point p has the error δ(x, y) + δφ·(−(p − c)_y, (p − c)_x). The error
of its image point is the derivative of N_i times that. Row 0 has no uncertainty, since D_0 is the identity by
definition.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.problem import AdjustmentResult


def row_covariances(adjusted: AdjustmentResult) -> Floats:
    """Compute the covariance of (φ, x, y) at the pivot for each of the m matrices D_j: (m, 3, 3), rad and mm."""
    motion = adjusted.motion
    m = len(motion.angle)
    c, s = np.cos(motion.angle), np.sin(motion.angle)
    # The adjustment uses the inverse of D_j, board = R(φ)·(x − c) + c + s. An error δs of this shift moves the ground
    # point by −R(−φ)·δs, and an error of the turn has the opposite sign.
    turn = np.zeros((m, 3, 3))
    turn[:, 0, 0] = -1
    turn[:, 1, 1], turn[:, 1, 2], turn[:, 2, 1], turn[:, 2, 2] = -c, -s, s, -c
    return np.asarray(turn @ adjusted.covariance[:, :3, :3] @ turn.swapaxes(1, 2))


def matrix_sigmas(cameras: Sequence[Camera], pivot_mm: Floats, rows: Floats) -> Floats:
    """Compute the standard deviations (n, m, 2) px of the matrices M_ij of n cameras and m rows.

    The two values are the standard deviation at the centre of the frame and that at its worst corner, each in the
    direction where it is largest.

    Args:
        cameras: the n cameras.
        pivot_mm: (2,) the pivot.
        rows: (m, 3, 3) covariances of the rows' motion, from `row_covariances`.
    """
    return np.array([_sigmas(camera, pivot_mm, rows) for camera in cameras])


def largest_sigma(covariance: Floats) -> Floats:
    """Compute the largest standard deviation over all directions, (…), for covariances (…, 2, 2)."""
    # Closed form of the larger eigenvalue of a symmetric 2×2 matrix, for all matrices at once.
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
    """Compute the derivatives (k, 2, 2) of undistorted pixels by ground points (k, 2), px/mm."""
    n = camera.image_from_row.matrix
    homogeneous = np.column_stack([ground_mm, np.ones(len(ground_mm))]) @ n.T
    px = homogeneous[:, :2] / homogeneous[:, 2:]
    return np.asarray((n[None, :2, :2] - px[:, :, None] * n[None, 2:, :2]) / homogeneous[:, 2, None, None])
