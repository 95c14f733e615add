"""The displacement of a camera against its calibration, and the camera matrix of the displaced camera.

A displacement has three numbers, all in px of the camera's frame. x and y are the motion of the picture of the
calibrated plane in the middle of the frame. The third, called turn, is the motion of the frame's corner when the
picture turns about the middle. If the working distance is known, the three numbers describe a small rotation of the
camera about its projection centre, because a knock turns a camera far more than it shifts it. If the working distance
is unknown, they describe a motion in the image plane.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera, Projective, System
from vaoi_station.geometry.transforms import Floats

PARAMETERS = 3
_CROSS = np.array(
    [[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], np.float64
)
"""Product with a vector: the entries of the matrix that multiplies by it as a cross product."""


class CameraMatrices(NamedTuple):
    """n cameras as arrays, from which the matrices of the displaced cameras are computed together."""

    image_from_row: Floats  # (n, 3, 3) N_i
    row_from_image: Floats  # (n, 3, 3) the inverse N_i
    inner: Floats  # (n, 3, 3) K: focal length, 1 where it is unknown, and principal point
    from_inner: Floats  # (n, 3, 3) K⁻¹
    focal_px: Floats  # (n,) ∞ where the working distance is unknown
    center_px: Floats  # (n, 2) middle of the frame

    @staticmethod
    def of(cameras: Sequence[Camera]) -> CameraMatrices:
        """Collect the matrices of cameras."""
        values = np.zeros((len(cameras), 5))
        for own, camera in zip(values, cameras, strict=True):
            # The focal length in px follows from resolution and working distance, since it is not calibrated alone.
            f = camera.px_per_mm * camera.working_distance_mm if camera.working_distance_mm else math.inf
            own[:] = f, *(camera.principal_point_px or camera.center_px), *camera.center_px
        f, x, y = values[:, :3].T
        one = np.where(np.isinf(f), 1.0, f)
        inner, outer = np.zeros((2, len(cameras), 3, 3))
        inner[:, 0, 0] = inner[:, 1, 1] = one
        outer[:, 0, 0] = outer[:, 1, 1] = 1 / one
        inner[:, 2, 2] = outer[:, 2, 2] = 1.0
        inner[:, 0, 2], inner[:, 1, 2], outer[:, 0, 2], outer[:, 1, 2] = x, y, -x / one, -y / one
        there = np.array([c.image_from_row.matrix for c in cameras]).reshape(-1, 3, 3)
        back = np.array([c.row_from_image.matrix for c in cameras]).reshape(-1, 3, 3)
        return CameraMatrices(there, back, inner, outer, f, values[:, 3:])

    def moved(self, displacement_px: Floats) -> Floats:
        """Return homographies T (..., n, 3, 3) from undistorted pixels as calibrated to those of the displaced cameras.

        A displaced camera (x, y, turn), (..., n, 3), has the matrix T·N_i. If the working distance is known, T is
        K·R·K⁻¹, the homography of a camera that turned about its projection centre by R.
        """
        # A turn is stated as the motion of the frame's corner.
        radius_px = np.hypot(*(self.center_px + 0.5).T)
        per_px = np.stack([-1 / self.focal_px, 1 / self.focal_px, 1 / radius_px], -1)
        rotation = displacement_px[..., [1, 0, 2]] * per_px
        cross = (rotation @ _CROSS).reshape(*rotation.shape, 3)
        # Rodrigues' formula, in a form that is exact for small angles
        half = np.sqrt(np.maximum((rotation * rotation).sum(-1), 1e-24))[..., None, None] / 2
        motion = np.eye(3) + np.sin(2 * half) / (2 * half) * cross + (np.sin(half) / half) ** 2 / 2 * (cross @ cross)
        flat = np.isinf(self.focal_px)
        if flat.any():
            motion[..., :2, 2] += np.where(flat[:, None], displacement_px[..., :2], 0.0)
        return np.asarray(self.inner @ motion @ self.from_inner, dtype=np.float64)

    def ground_changes(self, displacement_px: Floats) -> Floats:
        """Return homographies (n, 3, 3) from ground points by the calibrated cameras to those by the displaced ones."""
        back = np.linalg.inv(self.moved(displacement_px))
        return np.asarray(self.row_from_image @ back @ self.image_from_row, dtype=np.float64)


def displaced_cameras(cameras: Sequence[Camera], displacement_px: Floats) -> tuple[Camera, ...]:
    """Return the cameras with the N_i that result from their displacements (n, 3) px."""
    # Without a displacement, the same object is returned, so that a camera that has not moved keeps its exact N_i.
    if not np.any(displacement_px):
        return tuple(cameras)
    matrices = CameraMatrices.of(cameras)
    moved = matrices.moved(displacement_px) @ matrices.image_from_row
    return tuple(
        replace(camera, image_from_row=Projective(matrix / matrix[2, 2], System.IMAGE, System.ROW))
        if any(d)
        else camera
        for camera, matrix, d in zip(cameras, moved, displacement_px.tolist(), strict=True)
    )


def displace_camera(camera: Camera, displacement_px: Floats) -> Camera:
    """Return the camera with its N_i changed by a displacement (3,) px."""
    return displaced_cameras((camera,), np.reshape(displacement_px, (1, PARAMETERS)))[0]


def move_points(ground_mm: Floats, camera: NDArray[np.int_], changes: Floats) -> Floats:
    """Transform ground points (k, 2) of the cameras numbered `camera` (k,) by homographies (n, 3, 3)."""
    h = changes[camera]
    q = (h[:, :, :2] @ ground_mm[:, :, None])[:, :, 0] + h[:, :, 2]
    return np.asarray(q[:, :2] / q[:, 2:], dtype=np.float64)


def rms_displacement_px(displacement_px: Floats) -> float:
    """Compute the root mean square, over all points of the frame, of the picture's motion by a displacement (3,)."""
    x, y, corner = (float(v) for v in displacement_px)
    # Over a rectangle, the mean squared motion by a turn is a third of the squared motion at the corner.
    return math.sqrt(x * x + y * y + corner * corner / 3)
