"""The displacement of a camera against its calibration, and the camera matrix that follows.

Three numbers per camera, all in px of its own frame: the motion of the picture of the calibrated plane in the middle of
the frame (x, y), and the motion of the frame's corner by a turn about the middle (turn). With a working distance they
are a small rotation of the camera about its own centre, since a knock turns a camera much before it shifts it. Without
one they are a motion in the plane of the image.
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
    """Compute the distance from the middle of the frame to its corner, where a turn moves the picture most."""
    return math.hypot(camera.width_px, camera.height_px) / 2


def moved_from_calibrated(camera: Camera, displacement_px: Floats) -> Floats:
    """Build T (3, 3), from undistorted pixels as calibrated to those of now; N_i becomes T·N_i.

    With a working distance T is K·R·K⁻¹, the homography of a camera that turned about its centre.
    """
    x, y, corner = (float(v) for v in displacement_px)
    cx, cy = camera.principal_point_px or camera.center_px
    turn = corner / corner_radius_px(camera)
    if camera.working_distance_mm is None:
        c, s = math.cos(turn), math.sin(turn)
        return np.array([[c, -s, x + cx - c * cx + s * cy], [s, c, y + cy - s * cx - c * cy], [0, 0, 1]])
    # The focal length in px that belongs to this resolution at this distance; it is never calibrated by itself.
    f = camera.px_per_mm * camera.working_distance_mm
    rotation = cv2.Rodrigues(np.array([-y / f, x / f, turn]))[0]
    inner = np.array([[f, 0, cx], [0, f, cy], [0, 0, 1.0]])
    return np.asarray(inner @ rotation @ np.linalg.inv(inner), dtype=np.float64)


def displace_camera(camera: Camera, displacement_px: Floats) -> Camera:
    """Return the camera after a displacement."""
    # The same object for no displacement: an unmoved camera keeps its N_i to the last digit.
    if not np.any(displacement_px):
        return camera
    matrix = moved_from_calibrated(camera, displacement_px) @ camera.image_from_row.matrix
    return replace(camera, image_from_row=Projective(matrix / matrix[2, 2], System.IMAGE, System.ROW))


def rms_displacement_px(displacement_px: Floats) -> float:
    """Compute the motion of the picture, rms over the frame."""
    x, y, corner = (float(v) for v in displacement_px)
    # Over a rectangle, r² of a turn averages to a third of that at the corner.
    return math.sqrt(x * x + y * y + corner * corner / 3)
