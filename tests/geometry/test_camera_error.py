from __future__ import annotations

from typing import Any

import numpy as np

from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.geometry.camera_error import basis_px, frame_radius_px
from vaoi_station.geometry.transforms import apply


def _camera(covariance: Any = None) -> Camera:
    n = Projective(np.diag([40.0, 40.0, 1.0]), System.IMAGE, System.ROW)
    return Camera(801, 601, n, Lens((400.0, 300.0), 500.0), covariance_px2=covariance)


def _points(camera: Camera) -> Any:
    return np.random.default_rng(1).uniform((0, 0), (camera.width_px - 1, camera.height_px - 1), (40, 2))


def test_the_first_eight_fields_are_all_small_homographies() -> None:
    """Each change of the eight parameters of a homography is, to first order, a combination of them."""
    camera, g = _camera(), np.random.default_rng(2)
    p = _points(camera)
    normal = np.array([[1, 0, -400.0], [0, 1, -300.0], [0, 0, frame_radius_px(camera)]])
    change = np.linalg.inv(normal) @ (np.eye(3) + 1e-6 * g.normal(size=(3, 3))) @ normal
    moved = (apply(change, p) - p).ravel()
    design = basis_px(camera, p)[..., :8].reshape(-1, 8)
    _, left, rank, _ = np.linalg.lstsq(design, moved, rcond=None)
    assert rank == 8
    assert np.sqrt(left[0] / len(moved)) < 1e-4 * np.abs(moved).max()


def test_the_last_field_is_radial_distortion() -> None:
    camera = _camera()
    p, radius = _points(camera), frame_radius_px(camera)
    bent = Lens(camera.center_px, radius, (1.5 / radius,)).undistort(p) - p
    np.testing.assert_allclose(bent, basis_px(camera, p)[..., 8] * 1.5, atol=1e-9)
