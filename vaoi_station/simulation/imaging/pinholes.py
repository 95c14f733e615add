"""The true cameras of the twin: pinholes with small errors of position, rotation and focal length, and with distortion.

They use the full projection in three dimensions. The station uses formulas for planes at a height (`geometry.Camera`).
So a test can compare both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.geometry.transforms import Floats
from vaoi_station.simulation.scenario import ArraySection


@dataclass(frozen=True, eq=False)
class Pinhole:
    """One pinhole camera that looks down from the working distance.

    Image x is nearly parallel to tester x, and image y to tester y, unless the scenario mounts the camera rotated.
    """

    width_px: int
    height_px: int
    projection: Floats
    """Projection matrix (3, 4) from tester coordinates (x, y, z, 1) in mm, z up, to undistorted pixels."""
    lens: Lens
    foot_mm: tuple[float, float]
    """Foot of the camera: the point of the calibrated plane vertically below it, tester coordinates."""
    inner: Floats
    """Intrinsic matrix (3, 3) from directions in camera axes to undistorted pixels.

    In the image, camera x points to the right and y down. Camera z points along the viewing direction.
    """

    def plane(self) -> Floats:
        """Return N_i (3, 3): the homography from the calibrated plane z = 0 to undistorted pixels; N_33 is 1."""
        h = self.projection[:, [0, 1, 3]]
        return np.asarray(h / h[2, 2])

    def project(self, place_mm: Floats, z_mm: Floats | float) -> Floats:
        """Project tester coordinates (k, 2) at heights (k,) above the calibrated plane, or at one, to raw pixels."""
        xyz1 = np.column_stack([place_mm, np.broadcast_to(z_mm, len(place_mm)), np.ones(len(place_mm))])
        q = xyz1 @ self.projection.T
        return self.lens.distort(q[:, :2] / q[:, 2:])

    def ground(self, raw_px: Floats, z_mm: Floats | float) -> Floats:
        """Return the tester coordinates (k, 2) seen at raw pixels (k, 2), at heights (k,) or at one height."""
        p, m = self.lens.undistort(raw_px), self.projection
        a, b = m[0] - p[:, :1] * m[2], m[1] - p[:, 1:] * m[2]
        ra, rb = -(a[:, 2] * z_mm + a[:, 3]), -(b[:, 2] * z_mm + b[:, 3])
        # Two linear equations in x and y for each pixel, solved by Cramer's rule for all of them at once.
        det = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        return np.column_stack([(ra * b[:, 1] - a[:, 1] * rb) / det, (a[:, 0] * rb - ra * b[:, 0]) / det])

    def rotated(self, about: Literal["x", "y", "z"], angle_rad: float) -> Pinhole:
        """Return this camera rotated about one of its own axes. Its position does not change."""
        angles = {axis: angle_rad if axis == about else 0.0 for axis in "xyz"}
        turn = _rotation(angles["x"], angles["y"], angles["z"])
        return replace(self, projection=self.inner @ turn @ np.linalg.inv(self.inner) @ self.projection)

    def calibrated(self, working_distance_mm: float) -> Camera:
        """Return the `geometry.Camera` that a perfect calibration of this camera gives."""
        plane = Projective(self.plane(), System.IMAGE, System.ROW)
        return Camera(self.width_px, self.height_px, plane, self.lens, working_distance_mm)


def mount_cameras(array: ArraySection) -> tuple[Pinhole, ...]:
    """Return the cameras of the array with their mounting errors, which are drawn from the seed of the array."""
    return tuple(_mounted(array, i) for i in range(array.cameras))


def _mounted(array: ArraySection, camera: int) -> Pinhole:
    # There is one generator per camera, so camera i is the same in an array of any size.
    g = np.random.default_rng([array.seed, 7003, camera])
    shift, focal = g.normal(0, array.position_mm, 2), 1 + g.normal(0, array.focal_length)
    tilt_x, tilt_y = np.radians(g.normal(0, array.tilt_deg, 2))
    roll, strength = math.radians(array.design_roll_deg(camera) + g.normal(0, array.roll_deg)), g.uniform(0.6, 1.4)
    width_px, height_px = array.frame_px(camera)
    x, y = array.center_mm(camera) + shift[0], shift[1]
    middle = (width_px - 1) / 2, (height_px - 1) / 2
    f = array.working_distance_mm * array.resolution_px_per_mm(camera) * focal
    inner = np.array([[f, 0, middle[0]], [0, f, middle[1]], [0, 0, 1.0]])
    down = np.diag([1.0, 1.0, -1.0])
    place = np.array([[x], [y], [array.working_distance_mm]])
    projection = inner @ _rotation(tilt_x, tilt_y, roll) @ np.hstack([down, -down @ place])
    radius = math.hypot(width_px, height_px) / 2
    radial = (-array.distortion_px * float(strength) / radius,) if array.distortion_px else ()
    lens = Lens(middle, radius, radial)
    return Pinhole(width_px, height_px, projection, lens, (float(x), float(y)), inner)


def _rotation(about_x: float, about_y: float, about_z: float) -> Floats:
    """Return the matrix (3, 3) of a rotation about x, followed by one about y and one about z."""
    (cx, sx), (cy, sy), (cz, sz) = ((math.cos(a), math.sin(a)) for a in (about_x, about_y, about_z))
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1.0]])
    return np.asarray(rz @ ry @ rx)
