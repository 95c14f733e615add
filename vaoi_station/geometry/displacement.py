"""The displacement of a camera against its calibration, and the camera matrix of the displaced camera.

A displacement has three numbers, all in px of the camera's frame. x and y are the motion of the picture of the
calibrated plane in the middle of the frame. The third, called turn, is the motion of the frame's corner when the
picture turns about the middle. If the working distance is known, the three numbers describe a small rotation of the
camera about its projection centre, because a knock turns a camera far more than it shifts it. If the working distance
is unknown, they describe a motion in the image plane.
"""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np

from vaoi_station.geometry import Camera, Projective, System
from vaoi_station.geometry.transforms import Floats

PARAMETERS = 3


def corner_radius_px(camera: Camera) -> float:
    """Compute the distance in px from the middle of the frame to a corner, where a turn moves the picture most."""
    return math.hypot(camera.width_px, camera.height_px) / 2


def moved_from_calibrated(camera: Camera, displacement_px: Floats) -> Floats:
    """Build the homography T (3, 3) from undistorted pixels of the calibrated camera to those of the displaced one.

    The displaced camera has the matrix T·N_i. If the working distance is known, T is K·R·K⁻¹, the homography of a
    camera that turned about its projection centre by R; K holds the focal length and the principal point.
    """
    x, y, corner = (float(v) for v in displacement_px)
    cx, cy = camera.principal_point_px or camera.center_px
    turn = corner / corner_radius_px(camera)
    if camera.working_distance_mm is None:
        c, s = math.cos(turn), math.sin(turn)
        return np.array([[c, -s, x + cx - c * cx + s * cy], [s, c, y + cy - s * cx - c * cy], [0, 0, 1]])
    # The focal length in px follows from resolution and working distance, since it is not calibrated separately.
    f = camera.px_per_mm * camera.working_distance_mm
    rotation = cv2.Rodrigues(np.array([-y / f, x / f, turn]))[0]
    inner = np.array([[f, 0, cx], [0, f, cy], [0, 0, 1.0]])
    return np.asarray(inner @ rotation @ np.linalg.inv(inner), dtype=np.float64)


def displace_camera(camera: Camera, displacement_px: Floats) -> Camera:
    """Return the camera with its N_i changed by a displacement (3,) px."""
    # Without a displacement, the same object is returned, so that a camera that has not moved keeps its exact N_i.
    if not np.any(displacement_px):
        return camera
    matrix = moved_from_calibrated(camera, displacement_px) @ camera.image_from_row.matrix
    return replace(camera, image_from_row=Projective(matrix / matrix[2, 2], System.IMAGE, System.ROW))


def rms_displacement_px(displacement_px: Floats) -> float:
    """Compute the root mean square, over all points of the frame, of the picture's motion by a displacement (3,)."""
    x, y, corner = (float(v) for v in displacement_px)
    # Over a rectangle, the mean squared motion by a turn is a third of the squared motion at the corner.
    return math.sqrt(x * x + y * y + corner * corner / 3)
