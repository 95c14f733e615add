"""An independent pinhole camera, against which `geometry.Camera` is checked."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.geometry import Camera, Lens, Projective, System


@dataclass(frozen=True)
class Pinhole:
    """Focal length in px, place (x, y, height) in mm, tilts in rad; `y_down`: the tester's y runs down the image."""

    focal_px: float
    place_mm: tuple[float, float, float]
    tilt_rad: tuple[float, float, float]
    y_down: bool = True
    size_px: tuple[int, int] = (1392, 1040)

    def direction(self, vector: NDArray[np.float64]) -> NDArray[np.float64]:
        """A direction in the world (z up), seen from the camera (x right, y down, z ahead)."""
        x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
        y, z = (y if self.y_down else -y), -z
        about_x, about_y, about_z = self.tilt_rad
        y, z = y * math.cos(about_x) - z * math.sin(about_x), y * math.sin(about_x) + z * math.cos(about_x)
        x, z = x * math.cos(about_y) + z * math.sin(about_y), -x * math.sin(about_y) + z * math.cos(about_y)
        x, y = x * math.cos(about_z) - y * math.sin(about_z), x * math.sin(about_z) + y * math.cos(about_z)
        return np.stack([x, y, z], axis=-1)

    def project(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Undistorted pixels (..., 2) of points (..., 3)."""
        seen = self.direction(points_mm - np.array(self.place_mm))
        middle = np.array([(self.size_px[0] - 1) / 2, (self.size_px[1] - 1) / 2])
        return np.asarray(self.focal_px * seen[..., :2] / seen[..., 2:] + middle)

    def plane_homography(self) -> NDArray[np.float64]:
        """N_i from four points of the plane z = 0, by solving for its eight parameters."""
        x0, y0, _ = self.place_mm
        places = np.array([[x0 - 15, y0 - 12], [x0 + 16, y0 - 11], [x0 + 14, y0 + 12], [x0 - 13, y0 + 10]])
        pixels = self.project(np.column_stack([places, np.zeros(4)]))
        rows, right = [], []
        for (x, y), (u, v) in zip(places, pixels, strict=True):
            rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
            right += [u, v]
        return np.append(np.linalg.solve(np.array(rows), np.array(right)), 1.0).reshape(3, 3)


@pytest.fixture
def calibrated() -> Callable[..., Camera]:
    """Makes the `Camera` that a perfect calibration of a pinhole camera would give."""

    def make(pinhole: Pinhole, *, lens: Lens | None = None, distance_known: bool = True) -> Camera:
        return Camera(
            width_px=pinhole.size_px[0],
            height_px=pinhole.size_px[1],
            image_from_row=Projective(pinhole.plane_homography(), System.IMAGE, System.ROW),
            lens=lens or Lens((0.0, 0.0), 1.0),
            working_distance_mm=pinhole.place_mm[2] if distance_known else None,
        )

    return make


@pytest.fixture
def pinhole() -> type[Pinhole]:
    """The class of pinhole cameras."""
    return Pinhole
