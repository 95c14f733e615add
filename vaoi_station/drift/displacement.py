"""How a camera may be displaced against its calibration, and the camera and matrix that follow.

Three numbers per camera, all in px of its own frame: by how much the picture of the calibrated plane has moved
in the middle of the frame (x, y), and by how much a turn about the middle moves the frame's corner (turn). With
the working distance known they are a small rotation of the whole camera about its own centre: a knock turns
a camera much before it shifts it. Without it they are a motion in the plane of the image.
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
    """From the middle of the frame to its corner: where a turn moves the picture most."""
    return math.hypot(camera.width_px, camera.height_px) / 2


def moved_from_calibrated(camera: Camera, displacement_px: Floats) -> Floats:
    """T (3, 3): undistorted pixels as calibrated to undistorted pixels now; N_i becomes T·N_i.

    With a working distance K·R·K⁻¹, the picture of a camera that turned about its centre.
    """
    x, y, corner = (float(v) for v in displacement_px)
    cx, cy = camera.principal_point_px or camera.center_px
    turn = corner / corner_radius_px(camera)
    if camera.working_distance_mm is None:
        c, s = math.cos(turn), math.sin(turn)
        return np.array([[c, -s, x + cx - c * cx + s * cy], [s, c, y + cy - s * cx - c * cy], [0, 0, 1]])
    f = camera.px_per_mm * camera.working_distance_mm
    rotation = cv2.Rodrigues(np.array([-y / f, x / f, turn]))[0]
    inner = np.array([[f, 0, cx], [0, f, cy], [0, 0, 1.0]])
    return np.asarray(inner @ rotation @ np.linalg.inv(inner), dtype=np.float64)


def displace_camera(camera: Camera, displacement_px: Floats) -> Camera:
    """The camera as it looks now."""
    if not np.any(displacement_px):
        return camera
    matrix = moved_from_calibrated(camera, displacement_px) @ camera.image_from_row.matrix
    return replace(camera, image_from_row=Projective(matrix / matrix[2, 2], System.IMAGE, System.ROW))


def size_px(displacement_px: Floats) -> float:
    """How far the picture has moved, rms over the frame."""
    x, y, corner = (float(v) for v in displacement_px)
    return math.sqrt(x * x + y * y + corner * corner / 3)
